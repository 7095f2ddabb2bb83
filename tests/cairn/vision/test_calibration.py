"""Cameras are calibrated by images of a chessboard; what does not fit is told."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from cairn import CairnError
from cairn.vision.calibration import calibrate, camera_info
from cairn.vision.chessboard import Board, find_corners, in_order_of, other_board
from cairn.vision.images import read_image
from cairn.vision.rectification import Rectifier
from cairn.vision.stereo import StereoRig
from cairn.vision.stereo_calibration import calibrate_pair, camera_infos

pytestmark = pytest.mark.images


Array = NDArray[np.float64]

IMAGES = Path(__file__).parents[2] / "data" / "calibration"
BOARD = Board(9, 6, 0.025)
SIZE = (640, 480)
PUBLISHED_FOCAL = 534.80


@cache
def corners(side: str) -> dict[str, Array]:
    """The corners of the carried images, by the number of the pair."""
    found = {}
    for file in sorted(IMAGES.glob(f"{side}*.jpg")):
        seen = find_corners(read_image(file), BOARD)
        assert seen is not None, file
        found[file.stem.removeprefix(side)] = seen
    return found


PAIRS = {number: number for number in corners("left")}


def test_the_carried_pairs_are_calibrated_as_well_as_published() -> None:
    found = calibrate_pair(corners("left"), corners("right"), PAIRS, SIZE, BOARD)

    assert len(found.errors) == 13
    for camera in (found.left, found.right):
        assert camera.rms <= 0.25
        assert camera.intrinsics[0, 0] == pytest.approx(PUBLISHED_FOCAL, rel=0.01)
        assert camera.intrinsics[1, 1] == pytest.approx(PUBLISHED_FOCAL, rel=0.01)
        assert camera.focal_deviation < 1.0
    assert found.rms <= 0.25
    assert found.baseline == pytest.approx(3.33 * 0.025, rel=0.01)
    assert found.doubts() == []


def test_a_board_may_be_counted_from_another_end_in_the_right_image() -> None:
    right = corners("right") | {"05": corners("right")["05"][::-1]}

    found = calibrate_pair(corners("left"), right, PAIRS, SIZE, BOARD)

    assert (len(found.errors), found.left_out) == (13, {})


def test_rectified_corners_lie_in_the_same_rows_and_at_the_boards_distance() -> None:
    found = calibrate_pair(corners("left"), corners("right"), PAIRS, SIZE, BOARD)

    left, right = camera_infos(found, ("left", "right"))
    rig = StereoRig.of(left, right)
    rectified = [
        find_corners(Rectifier(info).apply(read_image(IMAGES / f"{side}04.jpg")), BOARD)
        for side, info in (("left", left), ("right", right))
    ]
    ours, theirs = rectified
    assert ours is not None
    assert theirs is not None
    theirs = in_order_of(theirs, ours, BOARD)

    assert np.abs(ours[:, 1] - theirs[:, 1]).max() < 1.0
    depth = rig.fx * rig.baseline / (ours[:, 0] - theirs[:, 0])
    places = np.column_stack(((ours[:, 0] - rig.cx) / rig.fx, (ours[:, 1] - rig.cy) / rig.fy))
    places = np.column_stack((places, np.ones(len(places)))) * depth[:, None]
    squares = np.linalg.norm(np.diff(places.reshape(6, 9, 3), axis=1), axis=2)
    assert squares.mean() == pytest.approx(0.025, rel=0.02)


def test_a_camera_alone_is_rectified_without_turning_it() -> None:
    found = calibrate(corners("left"), SIZE, BOARD)

    info = camera_info(found, "camera")

    assert np.array_equal(info.r, np.eye(3).ravel())
    assert info.p[3] == 0.0
    rectified = Rectifier(info).apply(np.full((480, 640), 200, np.uint8))
    assert rectified[2:-2, 2:-2].min() == 200


def test_an_image_that_does_not_fit_is_left_out_and_named() -> None:
    random = np.random.default_rng(1)
    seen = corners("left") | {"blurred": corners("left")["01"] + random.normal(0, 6, (54, 2))}

    found = calibrate(seen, SIZE, BOARD)

    assert list(found.left_out) == ["blurred"]
    assert found.left_out["blurred"] > 3
    assert found.rms <= 0.25


def test_an_image_that_fits_worse_is_used_but_named() -> None:
    random = np.random.default_rng(1)
    seen = dict(corners("left"))
    seen["05"] = seen["05"] + random.normal(0, 0.35, (54, 2))

    found = calibrate(seen, SIZE, BOARD)

    assert list(found.outlying) == ["05"]
    assert found.left_out == {}


def test_a_pair_not_taken_at_once_is_left_out() -> None:
    right = dict(corners("right"))
    right["03"], right["09"] = right["09"], right["03"]
    right["03"] = right["03"] + np.array((25.0, 0.0))
    del right["09"]

    found = calibrate_pair(corners("left"), right, PAIRS, SIZE, BOARD)

    assert list(found.left_out) == ["03"]
    assert "09" not in found.errors
    assert found.rms <= 0.25


def boards(*turns_deg: float) -> dict[str, NDArray[np.float64]]:
    """Corners of boards in front of a camera, turned about their upright axis."""
    random = np.random.default_rng(1)
    camera = np.array([[530.0, 0.0, 320.0], [0.0, 530.0, 240.0], [0.0, 0.0, 1.0]])
    seen = {}
    for turn in turns_deg:
        at = np.array([-0.1, -0.06, 0.6])
        about = np.array([0.0, np.deg2rad(turn), 0.0])
        projected, _ = cv2.projectPoints(BOARD.points, about, at, camera, np.zeros(5))
        seen[f"{turn:g}"] = projected[:, 0] + random.normal(0, 0.1, (len(projected), 2))
    return seen


def test_images_from_nearly_one_viewpoint_are_doubted() -> None:
    (focal, coverage, *_) = calibrate(boards(-5, 0, 3, 5), SIZE, BOARD).doubts()

    assert "the focal length is" in focal
    assert "+-" in focal
    assert "turned by" in focal
    assert "% of the image's width" in coverage


def test_images_from_one_viewpoint_are_refused() -> None:
    random = np.random.default_rng(1)
    one = corners("left")["01"]
    seen = {str(number): one + random.normal(0, 0.1, one.shape) for number in range(5)}

    with pytest.raises(CairnError, match=r"turned by 0 deg at most .* tell the focal length"):
        calibrate(seen, SIZE, BOARD)


def test_too_few_images_are_refused() -> None:
    two = dict(list(corners("left").items())[:2])

    with pytest.raises(CairnError, match="2 usable images of the board: a calibration needs 3"):
        calibrate(two, SIZE, BOARD)


def test_swapped_cameras_are_refused() -> None:
    with pytest.raises(CairnError, match=r"left and right are swapped: the right camera is 0\.08"):
        calibrate_pair(corners("right"), corners("left"), PAIRS, SIZE, BOARD)


def test_cameras_above_each_other_are_refused() -> None:
    def turned(side: str) -> dict[str, Array]:
        return {name: of[:, ::-1] * (1, -1) + (0, 640) for name, of in corners(side).items()}

    with pytest.raises(CairnError, match="only cameras side by side are supported"):
        calibrate_pair(turned("left"), turned("right"), PAIRS, (480, 640), BOARD)


def test_corners_counted_from_the_other_end_are_put_in_order() -> None:
    """Which of its ends is first is a toss for some boards."""
    ours = corners("left")["01"]
    theirs = ours + np.array((-20.0, 1.0))
    square = Board(6, 6, 0.025)
    grid = ours[:36].reshape(6, 6, 2)

    assert np.array_equal(in_order_of(theirs[::-1], ours, BOARD), theirs)
    quarter = np.rot90(grid).reshape(-1, 2)
    assert np.array_equal(in_order_of(quarter, ours[:36], square), ours[:36])


def test_corners_are_found_in_a_large_image_as_exactly() -> None:
    small = read_image(IMAGES / "left01.jpg")
    large = np.asarray(cv2.resize(small, None, fx=5, fy=5, interpolation=cv2.INTER_CUBIC), np.uint8)

    found = find_corners(large, BOARD)

    assert found is not None
    assert np.abs((found + 0.5) / 5 - 0.5 - corners("left")["01"]).max() < 0.3


def test_no_board_is_found_where_there_is_none() -> None:
    random = np.random.default_rng(1)

    assert find_corners(np.zeros((240, 320), np.uint8), BOARD) is None
    assert find_corners(random.integers(0, 255, (240, 320), np.uint8), BOARD) is None


def test_another_board_than_told_is_recognized() -> None:
    images = [read_image(IMAGES / "left01.jpg")]

    seen = other_board(images, Board(10, 5, 0.025))

    assert seen is not None
    assert str(seen) == "9x6"
    assert other_board(images, BOARD, larger=True) is None
    assert other_board(images, Board(8, 6, 0.025), larger=True) is not None
