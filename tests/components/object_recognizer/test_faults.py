"""Bad images, failing cameras, wrong calibrations: told, and never a wrong place."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cairn.components.object_recognizer.observation import Agreement
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import teach
from tests.components.object_recognizer.conftest import Robot
from tests.components.object_recognizer.scenes import SIZE, Thing, info, message, pair, picture_of

pytestmark = pytest.mark.images


Begin = Callable[..., Robot]
Complaints = Callable[[], str]
Logged = Callable[[], str]

HERE = Thing(1, 0.0, 1.5)
"""Its size is known."""
UNSIZED = Thing(3, 0.0, 1.5)


@pytest.mark.parametrize(
    ("left", "complaint"),
    [
        (np.zeros((480, 640), np.uint8), "left_image: it is too dark"),
        (np.random.default_rng(1).integers(0, 20, (480, 640)).astype(np.uint8), "too dark"),
        (np.full((480, 640), 255, np.uint8), "left_image: it is too bright"),
        (np.full((480, 640), 120, np.uint8), ""),  # as before a wall
        (np.full((4, 4), 120, np.uint8), "4 x 4 pixels: too few"),
        (np.full((10_000, 10_000), 120, np.uint8), "too large"),
        (np.full((480, 800), 120, np.uint8), "800 x 480 pixels, but its CameraInfo is of 640"),
    ],
)
def test_images_that_show_nothing_are_told_and_nothing_is_missed_in_them(
    robot: Begin, complaints: Complaints, left: np.ndarray[Any, Any], complaint: str
) -> None:
    it = robot().know()

    told = it.show(left, left)

    assert told is not None
    assert told.objects == ()
    assert (told.view_right, told.view_left, told.nearest, told.farthest) == (0, 0, 0, 0)
    assert complaint in complaints()
    assert len(it.see([HERE]).objects) == 1


@pytest.mark.parametrize(
    ("encoding", "convert"),
    [
        ("bgr8", lambda gray: cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)),
        ("mono16", lambda gray: gray.astype("<u2") << 4),
        ("rgba8", lambda gray: cv2.cvtColor(gray, cv2.COLOR_GRAY2RGBA)),
    ],
)
def test_color_and_16_bit_images_are_seen_as_gray_ones(
    robot: Begin, encoding: str, convert: Callable[[Any], Any]
) -> None:
    left, right = (convert(gray) for gray in pair([HERE]))

    told = robot().know().show(left, right, encoding)

    assert told is not None
    (one,) = told.objects
    assert one.range == pytest.approx(1.5, abs=0.03)


def test_an_encoding_that_is_not_known_is_told(robot: Begin, complaints: Complaints) -> None:
    told = robot().know().show(*pair([HERE]), encoding="jpeg")

    assert told is not None
    assert told.objects == ()
    assert "left_image: an image of left_camera" in complaints()
    assert "encoding = 'jpeg' is not known" in complaints()


def test_without_the_right_camera_objects_are_ranged_by_size_less_exactly(
    robot: Begin, complaints: Complaints, logged: Logged
) -> None:
    it = robot().know()
    exact = it.see([HERE]).objects[0].covariance[0]

    frames = [it.show(pair([HERE, replace(UNSIZED, x=0.6)], k)[0]) for k in range(8)]

    told = [frame for frame in frames if frame is not None]
    assert len(told) >= 2  # the first second it is waited for
    for frame in told:
        (one,) = frame.objects
        assert one.object_id == 1
        assert one.range == pytest.approx(1.5, abs=0.1)
        assert one.covariance[0] > 2 * exact
        assert frame.farthest == 0  # the other one is seen, but nobody can say where
    assert "no image on /robot/right_image is of the time of one on" in complaints()
    assert "poster 3: no range, for its size is not known" in complaints()

    it.show(*pair([HERE], 20))
    assert it.see([HERE]).objects[0].covariance[0] < 2 * exact
    assert "images come again on /robot/right_image" in logged()


def test_where_there_is_no_right_camera_the_remedy_is_told(
    robot: Begin, complaints: Complaints
) -> None:
    it = robot().know()
    for k in range(8):
        it.show(pair([HERE], k)[0])
    assert "Look after the right camera, or set stereo to false if there is none" in complaints()


def test_a_left_camera_that_is_silent_is_told(robot: Begin, complaints: Complaints) -> None:
    it = robot().know()
    for k in range(15):
        assert it.show(None, pair([HERE], k)[1]) is None
    assert "no image on /robot/left_image for 2 s: look after the camera" in complaints()


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_camera_that_hangs_is_told_and_its_images_tell_nothing(
    robot: Begin, complaints: Complaints, logged: Logged, side: str
) -> None:
    it = robot().know()
    still = pair([HERE])
    assert it.show(*still) is not None
    for k in range(1, 8):
        moving = pair([HERE], k)
        images = (still[0], moving[1]) if side == "left" else (moving[0], still[1])
        told = it.show(*images)
        if side == "left":
            assert told is None
    assert f"the images on /robot/{side}_image have been the same for 1 s" in complaints()
    if side == "right":
        assert told is not None
        assert told.objects[0].range == pytest.approx(1.5, abs=0.1)
    assert "stereo to false" not in complaints()  # it has sent images
    assert len(it.see([HERE]).objects) == 1
    assert f"the images on /robot/{side}_image change again" in logged()


@pytest.mark.parametrize(
    ("right", "why"),
    [
        (
            lambda left: np.zeros_like(left),
            "the right image shows next to nothing (it is too dark)",
        ),
        (lambda left: left, "right_image shows the same as /robot/left_image, bit for bit"),
    ],
)
def test_a_right_camera_that_shows_nothing_of_its_own_is_told(
    robot: Begin, complaints: Complaints, right: Callable[[Any], Any], why: str
) -> None:
    left, _ = pair([HERE])

    told = robot().know().show(left, right(left))

    assert told is not None
    assert told.objects[0].range == pytest.approx(1.5, abs=0.1)  # by its size
    assert why in complaints()
    assert "sizes alone" in complaints()


@pytest.mark.parametrize("thing", [HERE, UNSIZED])
def test_images_that_are_swapped_are_told_and_place_nothing(
    robot: Begin, complaints: Complaints, thing: Thing
) -> None:
    it = robot().know()
    left, right = pair([thing])

    told = it.show(right, left)

    assert told is not None
    assert told.objects == ()
    assert told.farthest == 0
    assert "left_image shows what the right camera sees: swap the cameras" in complaints()


def test_calibrations_that_are_swapped_are_told_and_place_nothing(
    robot: Begin, complaints: Complaints
) -> None:
    told = robot().know(info(right=True), info()).see([HERE])

    assert told.objects == ()
    assert "left and right are swapped" in complaints()


@pytest.mark.parametrize("factor", [0.7, 1.4, 2.0])
def test_a_calibration_that_is_far_off_is_told_and_places_nothing(
    robot: Begin, complaints: Complaints, factor: float
) -> None:
    it = robot().know(info(), info(right=True, baseline=0.12 * factor))

    told = it.see([HERE])

    assert told.objects == ()
    assert told.farthest == 0
    assert f"poster 1: it is at {1.5 * factor:.2f} m by stereo, but at 1.5" in complaints()


def test_a_calibration_that_is_a_little_off_is_told_and_widens_the_covariance(
    robot: Begin, complaints: Complaints
) -> None:
    exact = robot().know().see([HERE]).objects[0].covariance[0]
    it = robot().know(info(), info(right=True, baseline=0.12 * 1.15))
    for k in range(10):
        told = it.see([replace(HERE, x=-0.4 + 0.01 * k), Thing(2, 0.3, 1.2)])
        for one, true in zip(sorted(told.objects, key=lambda o: o.object_id), (1.5, 1.2)):  # noqa: B905
            assert abs(one.range - math.hypot(true, 0.3)) < 2.5 * math.sqrt(one.covariance[0])
            assert one.covariance[0] > 4 * exact
    assert "ranges by stereo differ from those by size (+15 % for poster 1, +15" in complaints()
    assert "calibrate the cameras anew" in complaints()


def test_a_size_that_is_wrong_is_told_apart_from_a_wrong_calibration(
    robot: Begin, complaints: Complaints, map_file: Path
) -> None:
    teach(map_file, "poster 1", [], (1.15 * SIZE[0], 1.15 * SIZE[1]))
    it = robot().know()
    for k in range(10):
        it.see([replace(HERE, x=-0.4 + 0.01 * k), Thing(2, 0.3, 1.2)])

    assert "tell the object's size by `cairn object teach 'poster 1'" in complaints()


def test_ranges_that_scatter_evenly_are_nothing_to_complain_of() -> None:
    agreement = Agreement()
    random = np.random.default_rng(1)
    told = {agreement.add("a", 1 + random.normal(0, 0.05)) for _ in range(200)}
    assert told == {""}


@pytest.mark.parametrize("stereo", [True, False])
def test_an_object_of_unknown_size_needs_stereo(
    robot: Begin, complaints: Complaints, stereo: bool
) -> None:
    told = robot(stereo=stereo).know().see([UNSIZED])

    assert [one.object_id for one in told.objects] == ([3] if stereo else [])
    assert ("poster 3: no range" in complaints()) != stereo


def test_two_of_an_unknown_size_are_not_taken_for_each_other(robot: Begin) -> None:
    it = robot().know()
    for z in (1.2, 1.4, 1.6, 1.8):
        for one in it.see([Thing(3, -0.3, z), Thing(3, 0.25, z)]).objects:
            x = 0.25 if one.bearing < 0 else -0.3
            assert one.range == pytest.approx(math.hypot(x, z), rel=0.05)


def test_without_calibration_nothing_is_placed_and_that_is_told(
    robot: Begin, complaints: Complaints
) -> None:
    it = robot()
    told = it.see([HERE])
    assert told.objects == ()
    assert told.farthest == 0
    assert "no CameraInfo has come on /robot/left_info" in complaints()

    empty = replace(info(), k=np.zeros(9), p=np.zeros(12))
    it.know(left=empty)
    assert it.see([HERE]).objects == ()
    assert "left_camera_optical_frame: its CameraInfo holds no calibration" in complaints()

    it.know()
    assert len(it.see([HERE]).objects) == 1


def test_a_right_camera_without_calibration_is_told_and_objects_are_ranged_by_size(
    robot: Begin, complaints: Complaints
) -> None:
    it = robot().know(right=replace(info(right=True), k=np.zeros(9), p=np.zeros(12)))

    told = it.see([HERE])

    assert told.objects[0].range == pytest.approx(1.5, abs=0.1)
    assert "objects are ranged by their sizes alone: right_camera" in complaints()


def test_objects_that_look_alike_are_told_as_alternatives(robot: Begin, map_file: Path) -> None:
    teach(map_file, "its twin", [make_view(picture_of(1))], SIZE)

    (one,) = robot().know().see([HERE]).objects

    assert {one.object_id, *one.alternatives.tolist()} == {1, 4}


def test_of_two_pairs_the_newer_one_is_looked_at(robot: Begin) -> None:
    it = robot().know()
    first, second = pair([HERE], 1), pair([Thing(2, 0.0, 1.5)], 2)

    # The right image of the first pair comes after the left one of the second.
    it.stage.give("left_image", message(first[0], 2000.0))
    it.stage.give("left_image", message(second[0], 2000.2))
    it.stage.give("right_image", message(first[1], 2000.0))
    it.stage.give("right_image", message(second[1], 2000.2))

    (told,) = it.stage.taken("objects")
    assert [one.object_id for one in told.objects] == [2]
