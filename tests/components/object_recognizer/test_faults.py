"""Tests of bad images, failing cameras and wrong calibrations: reported, never a wrong position."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cairn.components.object_recognizer.observation import RangeAgreement
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import add_views
from tests.components.object_recognizer.conftest import Robot
from tests.components.object_recognizer.scenes import SIZE, Thing, info, message, pair, picture_of
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = pytest.mark.images


Start = Callable[..., Robot]
Warnings = Callable[[], str]
Logged = Callable[[], str]

HERE = Thing(1, 0.0, 1.5)
"""A thing whose size is known."""
UNSIZED = Thing(3, 0.0, 1.5)


@pytest.mark.parametrize(
    ("left", "warning"),
    sampled(
        [
            (np.zeros((480, 640), np.uint8), "left_image: it is too dark"),
            (np.random.default_rng(1).integers(0, 20, (480, 640)).astype(np.uint8), "too dark"),
            (np.full((480, 640), 255, np.uint8), "left_image: it is too bright"),
            (np.full((480, 640), 120, np.uint8), ""),  # as in front of a wall
            (np.full((4, 4), 120, np.uint8), "4 x 4 pixels, too few"),
            (np.full((5_100, 5_100), 120, np.uint8), "too large"),
            (np.full((480, 800), 120, np.uint8), "800 x 480 pixels, but its CameraInfo is of 640"),
        ],
        3,
    ),
)
def test_images_that_show_nothing_are_reported_and_nothing_counts_as_missing(
    robot: Start, warnings: Warnings, left: np.ndarray[Any, Any], warning: str
) -> None:
    it = robot().calibrate()

    published = it.show(left, left)

    assert published is not None
    assert published.objects == ()
    assert (published.view_right, published.view_left, published.nearest, published.farthest) == (
        0,
        0,
        0,
        0,
    )
    assert warning in warnings()
    assert len(it.see([HERE]).objects) == 1


@pytest.mark.parametrize(
    ("encoding", "convert"),
    [
        ("bgr8", lambda gray: cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)),
        ("mono16", lambda gray: gray.astype("<u2") << 4),
        ("rgba8", lambda gray: cv2.cvtColor(gray, cv2.COLOR_GRAY2RGBA)),
    ],
)
def test_color_and_16_bit_images_are_recognized(
    robot: Start, encoding: str, convert: Callable[[Any], Any]
) -> None:
    left, right = (convert(gray) for gray in pair([HERE]))

    published = robot().calibrate().show(left, right, encoding)

    assert published is not None
    (one,) = published.objects
    assert one.range == pytest.approx(1.5, abs=0.03)


def test_unknown_encoding_is_reported(robot: Start, warnings: Warnings) -> None:
    published = robot().calibrate().show(*pair([HERE]), encoding="jpeg")

    assert published is not None
    assert published.objects == ()
    assert "left_image: an image of left_camera" in warnings()
    assert "encoding = 'jpeg' is not supported" in warnings()


def test_missing_right_camera_leaves_ranging_by_size_with_larger_covariance(
    robot: Start, warnings: Warnings, logged: Logged
) -> None:
    it = robot().calibrate()
    exact = it.see([HERE]).objects[0].covariance[0]

    frames = [it.show(pair([HERE, replace(UNSIZED, x=0.6)], k)[0]) for k in range(8)]

    published = [frame for frame in frames if frame is not None]
    assert len(published) >= 2  # the first second waits for the right camera
    for frame in published:
        (one,) = frame.objects
        assert one.object_id == 1
        assert one.range == pytest.approx(1.5, abs=0.1)
        assert one.covariance[0] > 2 * exact
        assert frame.farthest == 0  # the other object is visible, but its position is unknown
    assert_words(warnings(), "/robot/right_image", "stamp")
    assert_words(warnings(), "poster 3", "no range", "size")

    it.show(*pair([HERE], 20))
    assert it.see([HERE]).objects[0].covariance[0] < 2 * exact
    assert "images arrive again on /robot/right_image" in logged()


def test_absent_right_camera_is_reported_with_remedy(robot: Start, warnings: Warnings) -> None:
    it = robot().calibrate()
    for k in range(8):
        it.show(pair([HERE], k)[0])
    assert_words(warnings(), "right camera", "stereo", "false")


def test_silent_left_camera_is_reported(robot: Start, warnings: Warnings) -> None:
    it = robot().calibrate()
    for k in range(15):
        assert it.show(None, pair([HERE], k)[1]) is None
    assert_words(warnings(), "no image", "/robot/left_image", "2 s", "camera")


@pytest.mark.parametrize("side", ["left", "right"])
def test_frozen_camera_is_reported_and_its_images_are_ignored(
    robot: Start, warnings: Warnings, logged: Logged, side: str
) -> None:
    it = robot().calibrate()
    still = pair([HERE])
    assert it.show(*still) is not None
    for k in range(1, 8):
        moving = pair([HERE], k)
        images = (still[0], moving[1]) if side == "left" else (moving[0], still[1])
        published = it.show(*images)
        if side == "left":
            assert published is None
    assert f"the images on /robot/{side}_image have been identical for 1 s" in warnings()
    if side == "right":
        assert published is not None
        assert published.objects[0].range == pytest.approx(1.5, abs=0.1)
    assert "stereo to false" not in warnings()  # it has published images
    assert len(it.see([HERE]).objects) == 1
    assert f"the images on /robot/{side}_image change again" in logged()


@pytest.mark.parametrize(
    ("right", "why"),
    [
        (
            lambda left: np.zeros_like(left),
            "the right image shows next to nothing (it is too dark)",
        ),
        (lambda left: left, "right_image shows the same image as /robot/left_image, bit for bit"),
    ],
)
def test_useless_right_image_is_reported(
    robot: Start, warnings: Warnings, right: Callable[[Any], Any], why: str
) -> None:
    left, _ = pair([HERE])

    published = robot().calibrate().show(left, right(left))

    assert published is not None
    assert published.objects[0].range == pytest.approx(1.5, abs=0.1)  # by its size
    assert why in warnings()
    assert "by size only" in warnings()


@pytest.mark.parametrize("thing", [HERE, UNSIZED])
def test_swapped_images_are_reported_and_nothing_is_published(
    robot: Start, warnings: Warnings, thing: Thing
) -> None:
    it = robot().calibrate()
    left, right = pair([thing])

    published = it.show(right, left)

    assert published is not None
    assert published.objects == ()
    assert published.farthest == 0
    assert_words(warnings(), "left_image", "right camera", "swap")


def test_swapped_calibrations_are_reported_and_nothing_is_published(
    robot: Start, warnings: Warnings
) -> None:
    published = robot().calibrate(info(right=True), info()).see([HERE])

    assert published.objects == ()
    assert "left and right are swapped" in warnings()


@pytest.mark.parametrize("factor", [0.7, 1.4, 2.0])
def test_calibration_that_is_far_off_is_reported_and_nothing_is_published(
    robot: Start, warnings: Warnings, factor: float
) -> None:
    it = robot().calibrate(info(), info(right=True, baseline=0.12 * factor))

    published = it.see([HERE])

    assert published.objects == ()
    assert published.farthest == 0
    assert f"poster 1: its range is {1.5 * factor:.2f} m by stereo, but 1.5" in warnings()


@pytest.mark.accuracy
def test_calibration_that_is_slightly_off_is_reported_and_widens_the_covariance(
    robot: Start, warnings: Warnings
) -> None:
    exact = robot().calibrate().see([HERE]).objects[0].covariance[0]
    it = robot().calibrate(info(), info(right=True, baseline=0.12 * 1.15))
    for _ in range(9):
        published = it.see([replace(HERE, x=-0.4), Thing(2, 0.3, 1.2)])
        for one, true in zip(sorted(published.objects, key=lambda o: o.object_id), (1.5, 1.2)):  # noqa: B905
            assert abs(one.range - math.hypot(true, 0.3)) < 2.5 * math.sqrt(one.covariance[0])
            assert one.covariance[0] > 4 * exact
    assert "ranges by stereo differ from ranges by size (+15 % for poster 1, +15" in warnings()
    assert "calibrate the cameras again" in warnings()


@pytest.mark.accuracy
def test_wrong_size_is_distinguished_from_wrong_calibration(
    robot: Start, warnings: Warnings, map_file: Path
) -> None:
    add_views(map_file, "poster 1", [], (1.15 * SIZE[0], 1.15 * SIZE[1]))
    it = robot().calibrate()
    for _ in range(9):
        it.see([replace(HERE, x=-0.4), Thing(2, 0.3, 1.2)])

    assert_words(warnings(), "size", "`cairn object teach 'poster 1'")


def test_unbiased_ranges_give_no_warning() -> None:
    agreement = RangeAgreement()
    random = np.random.default_rng(1)
    published = {agreement.add("a", 1 + random.normal(0, 0.05)) for _ in range(200)}
    assert published == {""}


@pytest.mark.parametrize("stereo", [True, False])
def test_object_of_unknown_size_needs_stereo(
    robot: Start, warnings: Warnings, stereo: bool
) -> None:
    published = robot(stereo=stereo).calibrate().see([UNSIZED])

    assert [one.object_id for one in published.objects] == ([3] if stereo else [])
    assert ("poster 3: no range" in warnings()) != stereo


@pytest.mark.accuracy
def test_two_identical_objects_of_unknown_size_are_not_mixed_up(robot: Start) -> None:
    it = robot().calibrate()
    for z in (1.2, 1.4, 1.6, 1.8):
        for one in it.see([Thing(3, -0.3, z), Thing(3, 0.25, z)]).objects:
            x = 0.25 if one.bearing < 0 else -0.3
            assert one.range == pytest.approx(math.hypot(x, z), rel=0.05)


def test_missing_calibration_is_reported_and_nothing_is_published(
    robot: Start, warnings: Warnings
) -> None:
    it = robot()
    published = it.see([HERE])
    assert published.objects == ()
    assert published.farthest == 0
    assert "no CameraInfo has arrived on /robot/left_info" in warnings()

    empty = replace(info(), k=np.zeros(9), p=np.zeros(12))
    it.calibrate(left=empty)
    assert it.see([HERE]).objects == ()
    assert "left_camera_optical_frame: its CameraInfo has no calibration" in warnings()

    it.calibrate()
    assert len(it.see([HERE]).objects) == 1


def test_uncalibrated_right_camera_is_reported_and_objects_are_ranged_by_size(
    robot: Start, warnings: Warnings
) -> None:
    it = robot().calibrate(right=replace(info(right=True), k=np.zeros(9), p=np.zeros(12)))

    published = it.see([HERE])

    assert published.objects[0].range == pytest.approx(1.5, abs=0.1)
    assert "objects are ranged by size only: right_camera" in warnings()


def test_similar_objects_are_published_as_alternatives(robot: Start, map_file: Path) -> None:
    add_views(map_file, "its twin", [make_view(picture_of(1))], SIZE)

    (one,) = robot().calibrate().see([HERE]).objects

    assert {one.object_id, *one.alternatives.tolist()} == {1, 4}


def test_newer_of_two_pairs_is_processed(robot: Start) -> None:
    it = robot().calibrate()
    first, second = pair([HERE], 1), pair([Thing(2, 0.0, 1.5)], 2)

    # The right image of the first pair arrives after the left one of the second.
    it.recognizer.publish("left_image", message(first[0], 2000.0))
    it.recognizer.publish("left_image", message(second[0], 2000.2))
    it.recognizer.publish("right_image", message(first[1], 2000.0))
    it.recognizer.publish("right_image", message(second[1], 2000.2))

    (published,) = it.recognizer.take("objects")
    assert [one.object_id for one in published.objects] == [2]
