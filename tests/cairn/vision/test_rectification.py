"""Tests of rectification by ROS's camera models."""

from typing import Any

import cv2
import numpy as np
import pytest

from cairn import CairnError
from cairn.schemas.sensor_msgs import CameraInfo, RegionOfInterest
from cairn.vision.rectification import CameraModel, Rectifier, is_calibrated
from tests.cairn.vision.cameras import CX, CY, FOCAL, HEIGHT, WIDTH, info, pattern, projection
from tests.wording import words_in_order

pytestmark = pytest.mark.images


ROTATION = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]
RATIONAL = [0.2, -0.1, 0.001, -0.001, 0.02, 0.25, -0.05, 0.01]


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", [-0.3, 0.1, 0.001, -0.002, 0.0]),
        ("rational_polynomial", RATIONAL),
        ("equidistant", [0.02, -0.01, 0.003, 0.0]),
    ],
)
def test_rectified_image_equals_that_of_an_ideal_camera(model: str, d: list[float]) -> None:
    camera = info(
        distortion_model=model, d=np.array(d), r=ROTATION.ravel(), p=projection(300.0, 150.0, 125.0)
    )
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    raw_points = np.stack((columns, rows), axis=2).reshape(-1, 1, 2)
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    given = camera.k.reshape(3, 3), camera.d, camera.r.reshape(3, 3), camera.p.reshape(3, 4)[:, :3]
    ideal_points = np.asarray(undistort(raw_points, *given[:2], R=given[2], P=given[3]))
    ideal_points = ideal_points.astype(np.float64).reshape(HEIGHT, WIDTH, 2)
    raw = pattern(1, ideal_points[..., 0], ideal_points[..., 1], 15.0).astype(np.uint8)

    rectified = Rectifier(camera).apply(raw)

    ideal = pattern(1, columns, rows, 15.0)
    middle = np.s_[50:-50, 50:-50]
    assert np.abs(rectified[middle] - ideal[middle]).mean() < 2.0
    assert np.abs(raw[middle] - ideal[middle]).mean() > 20.0


def test_maps_follow_the_distortion_model() -> None:
    """By the equations of sensor_msgs/distortion_models.hpp, not by OpenCV."""
    k1, k2, p1, p2 = -0.3, 0.1, 0.001, -0.002
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    camera = info(d=np.array([k1, k2, p1, p2, 0.0]), p=projection(300.0, 150.0, 125.0))

    taken_x, taken_y = CameraModel.of(camera).maps()

    column, row = round(300 * x + 150), round(300 * y + 125)
    raw = taken_x[row, column], taken_y[row, column]
    assert raw == pytest.approx((FOCAL * u + CX, FOCAL * v + CY), abs=1e-3)


def test_rectified_image_is_returned_unchanged() -> None:
    image = np.zeros((HEIGHT, WIDTH), np.uint8)

    assert Rectifier(info()).apply(image) is image
    assert Rectifier(info(distortion_model="", d=np.zeros(0))).apply(image) is image


def test_single_camera_needs_neither_rotation_nor_projection() -> None:
    d = np.array([-0.3, 0.1, 0.001, -0.002, 0.0])

    bare = CameraModel.of(info(d=d, r=np.zeros(9), p=np.zeros(12)))

    whole = CameraModel.of(info(d=d, r=np.eye(3).ravel(), p=projection(FOCAL, CX, CY)))
    assert all(np.array_equal(*maps) for maps in zip(bare.maps(), whole.maps(), strict=True))


def test_camera_of_rectified_images_needs_only_the_projection() -> None:
    bare = CameraModel.of(info(k=np.zeros(9), d=np.zeros(0), r=np.zeros(9), distortion_model=""))

    assert bare.intrinsics.tolist() == info().p.reshape(3, 4)[:, :3].tolist()
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    given = info(k=np.zeros(9), d=np.zeros(0), r=np.zeros(9), distortion_model="")
    assert Rectifier(given).apply(image) is image


def test_image_of_another_size_is_rejected_with_both_sizes() -> None:
    with pytest.raises(CairnError, match=words_in_order("640 x 480", "320 x 240")):
        Rectifier(info()).apply(np.zeros((480, 640), np.uint8))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"k": np.zeros(9), "p": np.zeros(12)}, "has no calibration"),
        ({"k": np.array([-1, 0, 1, 0, 1, 1, 0, 0, 1.0])}, "k = .* is not a camera matrix"),
        ({"r": np.full(9, 0.5)}, "r = .* is not a rotation"),
        ({"d": np.zeros(3)}, "d has 3 coefficients, but plumb_bob has 4 or 5"),
        ({"distortion_model": "equidistant"}, "d has 5 coefficients, but equidistant has 4"),
        ({"distortion_model": "thin_prism"}, "distortion_model = 'thin_prism' is not supported"),
        ({"binning_x": 2, "binning_y": 2}, "binning of 2 x 2 is not supported"),
        ({"roi": RegionOfInterest(width=100, height=80, x_offset=3)}, "region of interest of 100"),
    ],
)
def test_invalid_calibration_is_rejected(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CairnError, match=message):
        Rectifier(info(**changes))


def test_uncalibrated_camera_is_detected() -> None:
    assert is_calibrated(info())
    assert not is_calibrated(CameraInfo(width=WIDTH, height=HEIGHT))
