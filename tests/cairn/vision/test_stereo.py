"""Tests of stereo: disparities are accurate to a fraction of a pixel, or missing."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn import CairnError
from cairn.vision.stereo import StereoRig, align, are_swapped, disparities, rows_off
from tests.cairn.vision.cameras import (
    BASELINE,
    CX,
    CY,
    FOCAL,
    HEIGHT,
    WIDTH,
    info,
    pattern,
    plane_pair,
    projection,
)
from tests.wording import words_in_order

pytestmark = pytest.mark.images


ALOE = Path(__file__).parents[2] / "data" / "stereo"
RIG = StereoRig.of(info(), info("right"))


def random_points(seed: int, count: int = 100) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform((60, 20), (WIDTH - 20, HEIGHT - 20), (count, 2))


@pytest.mark.accuracy
@given(
    seed=st.integers(0, 1000),
    middle=st.floats(3.0, 35.0),
    a=st.floats(-0.1, 0.1),
    b=st.floats(-0.1, 0.1),
)
@settings(max_examples=15, deadline=None)
def test_disparities_of_slanted_plane_are_accurate(
    seed: int, middle: float, a: float, b: float
) -> None:
    plane = (middle - a * CX - b * CY, a, b)
    left, right = plane_pair(seed, plane, noise=2.0)
    points = random_points(seed)

    found = disparities(left, right, points, RIG)

    true = plane[0] + points @ np.array([a, b])
    error = (found - true)[(~np.isnan(found)) & (true > 1.0)]
    assert error.size > 0.5 * np.count_nonzero(true > 1.0)
    assert np.percentile(np.abs(error), 95) < 0.2
    assert abs(np.median(error)) < 0.05


@pytest.mark.accuracy
def test_disparities_of_the_aloe_pair_are_accurate() -> None:
    left = cv2.imread(str(ALOE / "aloeL.jpg"), cv2.IMREAD_GRAYSCALE)
    right = cv2.imread(str(ALOE / "aloeR.jpg"), cv2.IMREAD_GRAYSCALE)
    true = cv2.imread(str(ALOE / "aloeGT.png"), cv2.IMREAD_GRAYSCALE)
    assert left is not None
    assert right is not None
    assert true is not None
    height, width = left.shape
    rig = StereoRig(3740.0, 3740.0, width / 2, height / 2, 0.16, width, height)
    keypoints = cv2.SIFT_create(nfeatures=1500).detect(left)  # type: ignore[attr-defined]
    points = np.array([key.pt for key in keypoints])

    found = disparities(left.astype(np.uint8), right.astype(np.uint8), points, rig, most=230.0)

    columns, rows = np.rint(points).astype(int).T
    known = ~np.isnan(found) & (true[rows, columns] > 0)
    error = np.abs(found[known] - true[rows, columns][known])
    assert known.mean() > 0.6
    assert np.median(error) < 0.5
    assert (error > 2.0).mean() < 0.02


def test_blank_wall_and_fence_have_no_disparity() -> None:
    """Noise must not decide, and slats are ambiguous."""
    random = np.random.default_rng(1)
    blank = [np.rint(random.normal(100, 0.7, (HEIGHT, WIDTH))).astype(np.uint8) for _ in "lr"]
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    slats, shifted = (
        128 + 80 * np.sin(2 * np.pi * (columns + shift) / 12) + 20 * np.sin(rows / 7)
        for shift in (0, 6)
    )
    # A fixed pattern of the sensor has a disparity, but that of nothing.
    stained = [blank[0], blank[0]]
    fence = [slats.astype(np.uint8), shifted.astype(np.uint8)]

    for left, right in (blank, stained, fence):
        assert np.isnan(disparities(left, right, random_points(1), RIG)).all()


def test_hidden_points_have_no_disparity() -> None:
    left, right = plane_pair(3, (12.0, 0.0, 0.0))
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    right[60:180, 100:200] = pattern(99, columns, rows)[60:180, 100:200].astype(np.uint8)
    hidden = np.random.default_rng(3).uniform((125, 75), (200, 165), (50, 2))

    found = disparities(left, right, hidden, RIG)

    assert np.isnan(found).mean() >= 0.9


def test_alignment_rejects_a_start_that_is_off_by_pixels() -> None:
    left, right = plane_pair(3, (12.0, 0.0, 0.0))
    points = random_points(3)

    assert np.isfinite(align(left, right, points, np.full(100, 12.4), 7)).mean() > 0.9
    assert np.isnan(align(left, right, points, np.full(100, 17.0), 7)).mean() > 0.95


def test_border_points_and_no_points_are_accepted() -> None:
    left, right = plane_pair(1, (10.0, 0.0, 0.0))

    assert np.isnan(disparities(left, right, np.array([(0.0, 0.0), (319.0, 239.0)]), RIG)).all()
    assert disparities(left, right, np.zeros((0, 2)), RIG).shape == (0,)


def test_swapped_images_have_negative_disparities() -> None:
    left, right = plane_pair(2, (15.0, 0.0, 0.0))
    points = random_points(2, 40)

    wrong = disparities(right, left, points, RIG, least=-40.0, most=40.0)

    assert np.nanmedian(wrong) == pytest.approx(-15.0, abs=0.1)
    assert are_swapped(right, left, points, RIG)
    assert not are_swapped(left, right, points, RIG)


@pytest.mark.parametrize("rows", [-5, -2, 0, 3])
def test_vertical_misalignment_is_measured(rows: int) -> None:
    left, right = plane_pair(3, (15.0, 0.02, 0.0))

    assert rows_off(left, np.roll(right, rows, axis=0), random_points(3), RIG) == rows


def test_unrelated_images_have_no_vertical_misalignment() -> None:
    left, _ = plane_pair(3, (15.0, 0.0, 0.0))
    _, right = plane_pair(4, (15.0, 0.0, 0.0))

    assert rows_off(left, right, random_points(3), RIG) == 0.0
    assert rows_off(left, np.full_like(left, 120), random_points(3), RIG) == 0.0
    assert rows_off(left, right, np.zeros((0, 2)), RIG) == 0.0


def test_dark_images_are_not_swapped() -> None:
    dark = np.zeros((HEIGHT, WIDTH), np.uint8)

    assert not are_swapped(dark, dark, random_points(1), RIG)


def test_principal_points_may_differ() -> None:
    """Without CALIB_ZERO_DISPARITY, the disparity at infinite distance is not 0."""
    right_info = info("right", p=projection(cx=CX - 4.0, tx=-FOCAL * BASELINE))
    rig = StereoRig.of(info(), right_info)
    left, right = plane_pair(4, (14.0, 0.0, 0.0))

    found = disparities(left, right, random_points(4), rig)

    assert rig.offset == 4.0
    assert np.nanmedian(found) == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        (
            info(),
            info("right", width=640),
            "calibrated for 320 x 240 pixels, the right one for 640",
        ),
        (info("right"), info("left"), "left and right are swapped"),
        (info(), info("left"), "no baseline: p.3. of the right one must be -fx"),
        (info(), info("right", k=np.zeros(9), p=np.zeros(12)), "right_camera.* has no calibration"),
        (info(), info("right", p=projection(cy=130.0, tx=-25.0)), "rows .* are not aligned"),
        (info(), info("right", p=projection(fx=260.0, tx=-25.0)), "rows .* are not aligned"),
    ],
)
def test_cameras_that_are_not_a_pair_are_rejected(left: Any, right: Any, message: str) -> None:
    with pytest.raises(CairnError, match=message):
        StereoRig.of(left, right)


def test_images_of_another_size_are_rejected() -> None:
    left, right = plane_pair(1, (10.0, 0.0, 0.0))

    with pytest.raises(CairnError, match=words_in_order("right image", "319 x 240", "320 x 240")):
        disparities(left, np.ascontiguousarray(right[:, 1:]), random_points(1), RIG)
