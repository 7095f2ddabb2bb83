"""The simulated camera's images agree with a pinhole projection to a fraction of a pixel."""

import math
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.simulation.rendering import CameraPose, ideal_image
from cairn.components.simulation.textures import drawn_picture
from cairn.planar.poses import Pose
from tests.components.simulation.camera_images import (
    LENS,
    POSTER,
    corners,
    cut_out,
    image_from,
    surfaces_with,
)
from tests.sweeps import sampled

pytestmark = pytest.mark.images


PICTURE = drawn_picture(7, (0.5, 0.4))
LOW = {"name": "it", "x": 4.0, "y": 2.0, "size": [0.6, 3.0], "height": 0.5}
HIGH = {**LOW, "height": 2.0}
PARTITION = [[[4.0, 0.0], [4.0, 4.0]]]
ROOM = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0], [0.0, 0.0]]
FINE = 4


def expected(around: NDArray[np.float64]) -> NDArray[np.float32]:
    """The image with the picture between four corners: means over pixels, 0 elsewhere."""
    height, width = PICTURE.shape
    right, bottom = width - 0.5, height - 0.5
    flat = np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)], np.float32)
    warp = cv2.getPerspectiveTransform(flat, (FINE * (around + 0.5) - 0.5).astype(np.float32))
    size = (FINE * LENS.width, FINE * LENS.height)
    fine = cv2.warpPerspective(PICTURE.astype(np.float32), warp, size)
    shape = (LENS.height, FINE, LENS.width, FINE)
    return np.asarray(fine.reshape(shape).mean(axis=(1, 3)), np.float32)


def within(around: NDArray[np.float64], border: int = 2) -> NDArray[np.bool_]:
    """The pixels inside four corners by at least that margin."""
    mask = np.zeros((LENS.height, LENS.width), np.uint8)
    cv2.fillConvexPoly(mask, np.round(around).astype(np.int32), 1)
    size = 2 * border + 1
    return np.asarray(cv2.erode(mask, np.ones((size, size)), borderValue=0) > 0)


@pytest.mark.parametrize(
    ("away", "aslant"),
    sampled(
        [(0.8, 40), (4.5, 20), (0.4, 0), (0.7, 0), (1.0, 70), (1.5, -75), (2.0, 30), (4.5, 0)], 2
    ),
)
def test_picture_is_at_its_projection_to_a_tenth_of_a_pixel(away: float, aslant: int) -> None:
    angle = math.radians(aslant)
    pose = (6.0 - away * math.cos(angle), 2.0 - away * math.sin(angle), angle)
    around = corners(POSTER, pose, 1.1)
    image = image_from(pose, 1.1, objects=[POSTER])
    inside = within(around)

    def off(x: float, y: float) -> float:
        there = expected(around + np.array((x, y)))
        return float(np.sqrt(np.mean((image - there)[inside] ** 2)))

    assert inside.sum() > 200
    here = off(0.0, 0.0)
    assert here < 8.0
    for x, y in ((0.25, 0), (-0.25, 0), (0, 0.25), (0, -0.25)):
        assert here < off(x, y)


@pytest.mark.accuracy
@given(st.floats(0.8, 5.0), st.sampled_from([0.05, 0.09, 0.2]), st.floats(-0.1, 0.1))
@settings(max_examples=25, deadline=None)
def test_disparity_is_focal_length_times_baseline_over_depth(
    away: float, baseline: float, aside: float
) -> None:
    pose: Pose = (6.0 - away, 2.0 + aside, 0.0)
    left, right = (
        cv2.GaussianBlur(image_from(pose, right=way, objects=[POSTER]), (0, 0), 1.0)
        for way in (0.0, baseline)
    )
    true = LENS.focal * baseline / away
    around = np.clip(corners(POSTER, pose), 0.0, (639, 479))
    x0, y0 = np.ceil(around[0] + (3, 3)).astype(int)
    x1, y1 = np.floor(around[2] - (3, 3)).astype(int)
    x0 = max(x0, math.ceil(true) + 3)
    columns, rows = np.meshgrid(
        np.arange(x0, x1, dtype=np.float32), np.arange(y0, y1, dtype=np.float32)
    )
    one, found = left[y0:y1, x0:x1], float(round(true))
    for _ in range(8):  # Gauss-Newton
        other = cv2.remap(right, columns - np.float32(found), rows, cv2.INTER_CUBIC)
        slope = np.gradient(other, axis=1)
        found += float(np.sum(slope * (other - one)) / np.sum(slope**2))

    assert found == pytest.approx(true, abs=0.1)


def shown(image: NDArray[np.float32], pose: Pose) -> float:
    """The similarity of the poster's picture with the image at its position."""
    around = corners(POSTER, pose)
    inside = within(around)
    return float(np.corrcoef(image[inside], expected(around)[inside])[0, 1])


@pytest.mark.parametrize(
    ("between", "there"),
    [
        ({}, True),
        ({"furniture": [LOW]}, True),
        ({"furniture": [HIGH]}, False),
        ({"walls": [{"points": ROOM}, {"points": PARTITION[0]}]}, False),
        ({"walls": [{"points": ROOM}, {"points": PARTITION[0], "surface": "glass"}]}, True),
        ({"walls": [{"points": ROOM}, {"points": PARTITION[0], "height": 0.7}]}, True),
    ],
    ids=["nothing", "low", "high", "wall", "glass", "low wall"],
)
def test_high_furniture_in_between_hides_a_picture(between: dict[str, Any], there: bool) -> None:
    pose = (2.0, 2.0, 0.0)
    image = image_from(pose, objects=[POSTER], **between)

    assert (shown(image, pose) > 0.98) == there


def test_person_hides_what_is_behind() -> None:
    surfaces, atlas = surfaces_with(objects=[POSTER])
    pose = (2.0, 2.0, 0.0)

    def around(*people: tuple[float, float, float]) -> float:
        everybody = surfaces.with_people(np.array(people).reshape(-1, 3))
        return shown(ideal_image(everybody, atlas, CameraPose(pose, 1.0), LENS), pose)

    assert around() > 0.98
    assert around((4.0, 3.0, 0.25)) > 0.98
    assert around((4.0, 2.0, 0.4)) < 0.2


def test_picture_has_a_blank_back_and_does_not_show_through_its_wall() -> None:
    partition = [{"points": ROOM}, {"points": [[4.0, 0.0], [4.0, 3.9]]}]
    on_it = {**POSTER, "x": 4.0}
    robot = {"x": 1.0, "y": 1.0}
    front, behind = (2.5, 2.0, 0.0), (5.5, 2.0, math.pi)
    inside = within(corners(on_it, front))

    assert image_from(front, objects=[on_it], walls=partition, robot=robot)[inside].std() > 30
    with_it = image_from(behind, objects=[on_it], walls=partition, robot=robot)
    without = image_from(behind, walls=partition, robot=robot)
    assert np.abs(with_it - without).max() < 1.0
    free = image_from(behind, objects=[on_it])
    assert free[inside].std() == pytest.approx(0.0, abs=1e-3)
    assert abs(float(free[inside].mean()) - float(without[inside].mean())) > 20


def test_camera_sees_over_low_furniture_from_its_far_edge_on() -> None:
    pose = (2.0, 2.0, 0.0)
    without, there = image_from(pose), image_from(pose, furniture=[{**LOW, "surface": "dark"}])
    changed = np.abs(there - without)[:, 320] > 1.0
    rows = np.nonzero(changed)[0]

    far = LENS.cy + LENS.focal * (1.0 - 0.5) / 2.3
    foot = LENS.cy + LENS.focal * 1.0 / 1.7
    assert rows[0] == pytest.approx(far, abs=1.0)
    assert rows[-1] == pytest.approx(min(foot, 479), abs=1.5)
    assert changed[rows[0] : rows[-1] + 1].mean() > 0.95


def test_camera_above_a_table_sees_its_top_and_what_is_beyond() -> None:
    pose = (4.0, 2.0, 0.0)  # above its center
    without, there = image_from(pose), image_from(pose, furniture=[{**LOW, "surface": "dark"}])
    edge = LENS.cy + LENS.focal * (1.0 - 0.5) / 0.3

    assert edge > 479  # it ends below the image
    assert np.abs(there - without).max() < 1.0
    near = [
        image_from(pose, 0.6, furniture=things) for things in ([], [{**LOW, "surface": "dark"}])
    ]
    changed = np.abs(near[1] - near[0])[:, 320] > 1.0
    first = int(np.ceil(LENS.cy + LENS.focal * (0.6 - 0.5) / 0.3))
    assert not changed[: first - 1].any()
    assert changed[first + 1 :].all()
    beside = image_from((3.0, 2.0, 0.0), 0.6, furniture=[{**LOW, "surface": "dark"}])[:, 320]
    border = int(LENS.cy + LENS.focal * (0.6 - 0.5) / 0.7)
    top, side = beside[border - 20 : border - 2].mean(), beside[border + 2 : border + 20].mean()
    assert top > 1.05 * side
    assert near[1][first + 1 :, 320].mean() == pytest.approx(top, rel=0.05)


@given(st.floats(0.3, 5.7), st.floats(0.3, 3.7), st.floats(-3.1, 3.1), st.floats(0.1, 2.4))
@settings(max_examples=20, deadline=None)
def test_every_pixel_is_painted_from_every_pose(
    x: float, y: float, theta: float, height: float
) -> None:
    corner = {"name": "it", "x": 3.0, "y": 2.0, "theta": 0.4, "height": 0.7}
    outline = [[-1, -1], [1, -1], [1, 1], [0.2, 0.1], [-1, 1]]
    image = image_from(
        (x, y, theta), height, furniture=[{**corner, "outline": outline}], objects=[POSTER]
    )

    assert np.isfinite(image).all()
    assert image.min() > 2.0
    assert image.max() < 300.0


@given(st.floats(0.0, 0.02), st.floats(1.0, 2.5))
@settings(max_examples=25, deadline=None)
def test_pixel_at_an_edge_is_the_mean_over_its_area(step: float, away: float) -> None:
    pose = (3.0 - away, 2.0, 0.0)
    visible_object = {**POSTER, "x": 3.0, "y": 2.0 + step, "theta": 0.0}  # its back is blank
    row = LENS.height // 2
    there, plain = (
        image_from(pose, objects=things)[row].astype(float) for things in ([visible_object], [])
    )
    left = corners(visible_object, pose)[1, 0]
    whole = math.floor(left + 0.5)

    back = there[whole + 2]
    assert np.ptp(there[whole + 1 : whole + 20]) < 1e-3
    covered = (there[whole] - plain[whole]) / (back - plain[whole])
    assert covered == pytest.approx(whole + 0.5 - left, abs=0.02)
    assert there[whole - 1] == pytest.approx(plain[whole - 1], abs=0.1)


def test_rectified_cutout_equals_the_picture() -> None:
    pose = (5.2, 2.2, -0.4)
    image = image_from(pose, objects=[POSTER])
    height, width = PICTURE.shape

    flat = cut_out(image, corners(POSTER, pose), width, height)

    assert np.corrcoef(flat.ravel(), PICTURE.ravel())[0, 1] > 0.97
    assert np.corrcoef(flat[:, ::-1].ravel(), PICTURE.ravel())[0, 1] < 0.3
