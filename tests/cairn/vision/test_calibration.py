"""Tests of calibration by images of a chessboard."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from cairn import CairnError
from cairn.vision.calibration import (
    calibrate,
    calibrate_pair,
    single_camera_info,
    stereo_camera_infos,
)
from cairn.vision.chessboard import Board, find_corners, find_other_board, reorder_like
from cairn.vision.images import read_image
from cairn.vision.rectification import Rectifier
from cairn.vision.stereo import StereoRig
from tests.wording import words_in_order

pytestmark = pytest.mark.images


Array = NDArray[np.float64]

IMAGES = Path(__file__).parents[2] / "data" / "calibration"
BOARD = Board(9, 6, 0.025)
SIZE = (640, 480)
PUBLISHED_FOCAL = 534.80


@cache
def corners(side: str) -> dict[str, Array]:
    """Return the corners in the images of the repository, by the number of the pair."""
    found = {}
    for file in sorted(IMAGES.glob(f"{side}*.jpg")):
        seen = find_corners(read_image(file), BOARD)
        assert seen is not None, file
        found[file.stem.removeprefix(side)] = seen
    return found


PAIRS = {number: number for number in corners("left")}


def test_calibration_is_as_accurate_as_published() -> None:
    found = calibrate_pair(corners("left"), corners("right"), PAIRS, SIZE, BOARD)

    assert len(found.errors) == 13
    for camera in (found.left, found.right):
        assert camera.rms <= 0.25
        assert camera.intrinsics[0, 0] == pytest.approx(PUBLISHED_FOCAL, rel=0.01)
        assert camera.intrinsics[1, 1] == pytest.approx(PUBLISHED_FOCAL, rel=0.01)
        assert camera.focal_deviation < 1.0
    assert found.rms <= 0.25
    assert found.baseline == pytest.approx(3.33 * 0.025, rel=0.01)
    assert found.warnings() == []


def test_corners_may_start_at_another_end_in_the_right_image() -> None:
    right = corners("right") | {"05": corners("right")["05"][::-1]}

    found = calibrate_pair(corners("left"), right, PAIRS, SIZE, BOARD)

    assert (len(found.errors), found.excluded) == (13, {})


def test_rectified_corners_are_in_equal_rows_at_the_true_distance() -> None:
    found = calibrate_pair(corners("left"), corners("right"), PAIRS, SIZE, BOARD)

    left, right = stereo_camera_infos(found, ("left", "right"))
    rig = StereoRig.of(left, right)
    rectified = [
        find_corners(Rectifier(info).apply(read_image(IMAGES / f"{side}04.jpg")), BOARD)
        for side, info in (("left", left), ("right", right))
    ]
    ours, theirs = rectified
    assert ours is not None
    assert theirs is not None
    theirs = reorder_like(theirs, ours, BOARD)

    assert np.abs(ours[:, 1] - theirs[:, 1]).max() < 1.0
    depth = rig.fx * rig.baseline / (ours[:, 0] - theirs[:, 0])
    points = np.column_stack(((ours[:, 0] - rig.cx) / rig.fx, (ours[:, 1] - rig.cy) / rig.fy))
    points = np.column_stack((points, np.ones(len(points)))) * depth[:, None]
    squares = np.linalg.norm(np.diff(points.reshape(6, 9, 3), axis=1), axis=2)
    assert squares.mean() == pytest.approx(0.025, rel=0.02)


def test_single_camera_is_rectified_without_rotation() -> None:
    found = calibrate(corners("left"), SIZE, BOARD)

    info = single_camera_info(found, "camera")

    assert np.array_equal(info.r, np.eye(3).ravel())
    assert info.p[3] == 0.0
    rectified = Rectifier(info).apply(np.full((480, 640), 200, np.uint8))
    assert rectified[2:-2, 2:-2].min() == 200


def test_image_that_does_not_fit_is_excluded() -> None:
    random = np.random.default_rng(1)
    seen = corners("left") | {"blurred": corners("left")["01"] + random.normal(0, 6, (54, 2))}

    found = calibrate(seen, SIZE, BOARD)

    assert list(found.excluded) == ["blurred"]
    assert found.excluded["blurred"] > 3
    assert found.rms <= 0.25


def test_image_that_fits_worse_is_used_and_reported() -> None:
    random = np.random.default_rng(1)
    seen = dict(corners("left"))
    seen["05"] = seen["05"] + random.normal(0, 0.35, (54, 2))

    found = calibrate(seen, SIZE, BOARD)

    assert list(found.outlying) == ["05"]
    assert found.excluded == {}


def test_pair_of_different_moments_is_excluded() -> None:
    right = dict(corners("right"))
    right["03"], right["09"] = right["09"], right["03"]
    right["03"] = right["03"] + np.array((25.0, 0.0))
    del right["09"]

    found = calibrate_pair(corners("left"), right, PAIRS, SIZE, BOARD)

    assert list(found.excluded) == ["03"]
    assert "09" not in found.errors
    assert found.rms <= 0.25


def boards(*turns_deg: float) -> dict[str, NDArray[np.float64]]:
    """Return corners of boards in front of a camera, rotated about their vertical axis."""
    random = np.random.default_rng(1)
    camera = np.array([[530.0, 0.0, 320.0], [0.0, 530.0, 240.0], [0.0, 0.0, 1.0]])
    seen = {}
    for turn in turns_deg:
        at = np.array([-0.1, -0.06, 0.6])
        about = np.array([0.0, np.deg2rad(turn), 0.0])
        projected, _ = cv2.projectPoints(BOARD.points, about, at, camera, np.zeros(5))
        seen[f"{turn:g}"] = projected[:, 0] + random.normal(0, 0.1, (len(projected), 2))
    return seen


def test_images_from_nearly_one_viewpoint_give_warnings() -> None:
    (focal, coverage, *_) = calibrate(boards(-5, 0, 3, 5), SIZE, BOARD).warnings()

    assert "the focal length is" in focal
    assert "+-" in focal
    assert "rotated by" in focal
    assert "% of the image's width" in coverage


def test_images_from_one_viewpoint_are_rejected() -> None:
    random = np.random.default_rng(1)
    one = corners("left")["01"]
    seen = {str(number): one + random.normal(0, 0.1, one.shape) for number in range(5)}

    with pytest.raises(CairnError, match=r"rotated by at most 0 deg .* focal length"):
        calibrate(seen, SIZE, BOARD)


def test_too_few_images_are_rejected() -> None:
    two = dict(list(corners("left").items())[:2])

    with pytest.raises(CairnError, match=words_in_order("2 usable images", "at least 3")):
        calibrate(two, SIZE, BOARD)


def test_swapped_cameras_are_rejected() -> None:
    with pytest.raises(CairnError, match=words_in_order("swapped", "0.08")):
        calibrate_pair(corners("right"), corners("left"), PAIRS, SIZE, BOARD)


def test_cameras_above_each_other_are_rejected() -> None:
    def turned(side: str) -> dict[str, Array]:
        return {name: of[:, ::-1] * (1, -1) + (0, 640) for name, of in corners(side).items()}

    with pytest.raises(CairnError, match="mount the cameras side by side"):
        calibrate_pair(turned("left"), turned("right"), PAIRS, (480, 640), BOARD)


def test_corners_are_reordered_like_those_of_the_other_camera() -> None:
    """The first corner of a symmetric board is ambiguous."""
    ours = corners("left")["01"]
    theirs = ours + np.array((-20.0, 1.0))
    square = Board(6, 6, 0.025)
    grid = ours[:36].reshape(6, 6, 2)

    assert np.array_equal(reorder_like(theirs[::-1], ours, BOARD), theirs)
    quarter = np.rot90(grid).reshape(-1, 2)
    assert np.array_equal(reorder_like(quarter, ours[:36], square), ours[:36])


def test_corners_in_large_image_are_as_accurate() -> None:
    small = read_image(IMAGES / "left01.jpg")
    large = np.asarray(cv2.resize(small, None, fx=5, fy=5, interpolation=cv2.INTER_CUBIC), np.uint8)

    found = find_corners(large, BOARD)

    assert found is not None
    assert np.abs((found + 0.5) / 5 - 0.5 - corners("left")["01"]).max() < 0.3


def test_images_without_board_give_no_corners() -> None:
    random = np.random.default_rng(1)

    assert find_corners(np.zeros((240, 320), np.uint8), BOARD) is None
    assert find_corners(random.integers(0, 255, (240, 320), np.uint8), BOARD) is None


@pytest.mark.accuracy
def test_board_of_another_size_is_found() -> None:
    images = [read_image(IMAGES / "left01.jpg")]

    seen = find_other_board(images, Board(10, 5, 0.025))

    assert seen is not None
    assert str(seen) == "9x6"
    assert find_other_board(images, BOARD, larger=True) is None
    assert find_other_board(images, Board(8, 6, 0.025), larger=True) is not None
