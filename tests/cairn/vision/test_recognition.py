"""Tests of recognition in synthetic images."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.vision.features import extract, no_features
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.vision.recognition import Detection, Recognizer
from tests.cairn.vision.scenes import (
    HEIGHT,
    WIDTH,
    Gray,
    Homography,
    at,
    corner_error,
    model,
    paste,
    view,
    wall,
)
from tests.cairn.visual_map.views import texture
from tests.sweeps import sampled

pytestmark = pytest.mark.images


# The number of features that a robot uses; 0 means all of them, as for a single image.
ROBOT, ALL = 2000, 0

PICTURES = [texture(seed) for seed in range(8)]
OBJECTS = [model(number, picture) for number, picture in enumerate(PICTURES)]
KNOWN = Recognizer(OBJECTS)


def recognized(image: Gray, known: Recognizer = KNOWN, most: int = ROBOT) -> list[Detection]:
    return known.recognize(extract(image, most), image.shape[1], image.shape[0])


def ids(found: Sequence[Detection]) -> list[int]:
    return sorted(each.object_id for each in found)


def test_object_is_detected_with_name_and_corners() -> None:
    homography = at(300, 100, 1.3, 25)

    (found,) = recognized(paste(wall(), PICTURES[3], homography))

    assert (found.object_id, found.name, found.view) == (3, "object 3", 0)
    assert found.alternatives == ()
    assert corner_error(found, PICTURES[3], homography) < 2
    assert found.inliers > 30
    projected = cv2.perspectiveTransform(found.view_points[None], found.homography)[0]
    assert np.linalg.norm(projected - found.image_points, axis=1).max() < 6


@settings(max_examples=8, deadline=None)
@given(
    st.floats(100, 300),
    st.floats(100, 200),
    st.floats(0.7, 1.8),
    st.floats(-180, 180),
    st.floats(-4e-4, 4e-4),
    st.floats(-4e-4, 4e-4),
)
def test_object_is_detected_at_any_position_scale_rotation_and_slant(
    x: float, y: float, scale: float, turn: float, slant_x: float, slant_y: float
) -> None:
    centered = np.array([[1.0, 0, -79.5], [0, 1.0, -59.5], [slant_x, slant_y, 1.0]])
    homography = at(x + 80, y + 60, scale, turn) @ centered

    found = recognized(paste(wall(), PICTURES[0], homography))

    assert ids(found) == [0]
    assert corner_error(found[0], PICTURES[0], homography) < 6


def test_several_objects_and_instances_are_detected() -> None:
    poses = [(2, at(20, 20)), (5, at(230, 40, 1.2, 10)), (2, at(60, 250, 1.1, -15))]
    poses += [(2, at(560, 200, 1.0, 60)), (7, at(330, 300))]
    image = wall()
    for number, homography in poses:
        image = paste(image, PICTURES[number], homography)

    found = recognized(image)

    assert ids(found) == [2, 2, 2, 5, 7]
    for number, homography in poses:
        errors = [
            corner_error(each, PICTURES[number], homography)
            for each in found
            if each.object_id == number
        ]
        assert min(errors) < 3


@pytest.mark.parametrize("homography", [at(-60, 100, 1.2), at(560, 300, 1.2), at(200, -60, 1.3, 8)])
def test_object_partly_outside_of_the_image_is_detected(homography: Homography) -> None:
    (found,) = recognized(paste(wall(), PICTURES[1], homography))

    assert found.object_id == 1
    assert corner_error(found, PICTURES[1], homography) < 8


def test_half_covered_object_is_detected() -> None:
    homography = at(200, 150, 1.5)
    image = paste(wall(), PICTURES[1], homography)
    image[:, 320:] = wall(998)[:, 320:]

    (found,) = recognized(image)

    assert found.object_id == 1
    assert corner_error(found, PICTURES[1], homography) < 8


@pytest.mark.parametrize(
    "image",
    sampled(
        [
            wall(),
            wall(1234),
            np.zeros((HEIGHT, WIDTH), np.uint8),
            np.full((HEIGHT, WIDTH), 255, np.uint8),
            np.zeros((1, 1), np.uint8),
            np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8),
        ],
        2,
    ),
)
def test_images_without_objects_give_no_detection(image: Gray) -> None:
    assert recognized(image, most=ALL) == []


def test_mirror_image_is_not_detected() -> None:
    mirrored = np.ascontiguousarray(PICTURES[3][:, ::-1])

    assert recognized(paste(wall(), mirrored, at(200, 100, 1.5)), most=ALL) == []


def test_shuffled_picture_is_not_detected() -> None:
    tiles = PICTURES[3].reshape(4, 30, 4, 40).swapaxes(1, 2).reshape(16, 30, 40)
    # No tile keeps its neighbor.
    order = [0, 2, 4, 6, 9, 11, 13, 15, 1, 3, 5, 7, 8, 10, 12, 14]
    shuffled = tiles[order].reshape(4, 4, 30, 40).swapaxes(1, 2).reshape(120, 160)

    assert recognized(paste(wall(), shuffled, at(200, 100, 1.2)), most=ALL) == []


def test_object_is_detected_in_blurred_noisy_and_dark_images() -> None:
    image = paste(wall(), PICTURES[4], at(200, 150, 1.5, 10))
    noise = np.random.default_rng(3).normal(0, 10, image.shape)
    noisy = np.clip(image + noise, 0, 255).astype(np.uint8)
    dark = (image * 0.4).astype(np.uint8)
    blurred = cv2.GaussianBlur(image, (0, 0), 2.0).astype(np.uint8)

    assert [ids(recognized(each)) for each in (noisy, dark, blurred)] == [[4], [4], [4]]


def test_similar_objects_give_one_detection_with_an_alternative() -> None:
    noise = np.random.default_rng(4).normal(0, 5, PICTURES[0].shape)
    twin = np.clip(PICTURES[0] + noise, 0, 255).astype(np.uint8)
    known = Recognizer([*OBJECTS, model(70, twin)])

    (found,) = recognized(paste(wall(), PICTURES[0], at(200, 150, 1.3)), known)

    assert {found.object_id, *found.alternatives} == {0, 70}
    assert recognized(paste(wall(), PICTURES[5], at(200, 150, 1.3)), known)[0].alternatives == ()


def test_object_with_many_identical_models_has_alternatives() -> None:
    known = Recognizer([replace(OBJECTS[0], object_id=number) for number in range(25)])

    (found,) = recognized(paste(wall(), PICTURES[0], at(200, 150, 1.3)), known)

    assert found.alternatives


def test_views_of_one_object_are_not_alternatives() -> None:
    other = cv2.GaussianBlur(PICTURES[0], (0, 0), 0.8).astype(np.uint8)
    known = Recognizer([model(1, other, PICTURES[0]), OBJECTS[5]])

    (found,) = recognized(paste(wall(), PICTURES[0], at(200, 150, 1.3)), known, ALL)

    assert (found.object_id, found.view, found.alternatives) == (1, 1, ())


@pytest.mark.accuracy
def test_object_attached_to_another_is_detected_as_well() -> None:
    poster = np.full((300, 300), 128, np.uint8)
    poster[160:280, 20:180] = PICTURES[6]
    poster[10:130, 200:280] = texture(78)[:, :80]
    known = Recognizer([*OBJECTS, model(90, poster)])

    assert ids(recognized(paste(wall(), poster, at(60, 60, 1.2)), known, ALL)) == [6, 90]
    assert ids(recognized(paste(wall(), PICTURES[6], at(60, 60, 1.2)), known, ALL)) == [6]


def test_order_of_models_does_not_matter() -> None:
    image = paste(paste(wall(), PICTURES[2], at(20, 20, 1.2)), PICTURES[5], at(330, 250, 1.3))

    features = extract(image)

    for known in (KNOWN, Recognizer(OBJECTS[::-1])):
        assert ids(known.recognize(features, WIDTH, HEIGHT)) == [2, 5]


def test_recognition_is_deterministic() -> None:
    image = paste(wall(), PICTURES[2], at(200, 100, 1.2, 33))

    one, other = recognized(image), recognized(image, Recognizer(OBJECTS))

    assert len(one) == 1
    assert np.array_equal(one[0].homography, other[0].homography)
    assert np.array_equal(one[0].image_points, other[0].image_points)


def test_recognizer_copies_the_list_of_objects() -> None:
    objects = OBJECTS[:2]
    known = Recognizer(objects)
    objects.clear()

    assert ids(recognized(paste(wall(), PICTURES[1], at(200, 100, 1.2)), known)) == [1]


def test_models_without_features_or_views_are_never_detected() -> None:
    blank = ModelView(100, 80, no_features(), np.zeros((80, 100), np.uint8))
    features = extract(paste(wall(), PICTURES[1], at(200, 100, 1.2)))

    for nothing in ([], [ObjectModel(5, "blank", None, (blank,))]):
        assert Recognizer(nothing).recognize(features, WIDTH, HEIGHT) == []
    known = Recognizer([ObjectModel(6, "unseen", None, ()), *OBJECTS[:2]])
    assert ids(known.recognize(features, WIDTH, HEIGHT)) == [1]


def test_object_in_front_of_another_is_detected_separately() -> None:
    image = paste(wall(), PICTURES[1], at(150, 100, 1.8))
    image = paste(image, PICTURES[2], at(220, 150, 0.8))

    assert ids(recognized(image)) == [1, 2]


def test_view_is_detected_in_its_own_picture() -> None:
    again = view(PICTURES[0])

    (found,) = KNOWN.recognize(again.features, again.width, again.height)

    assert found.object_id == 0
    np.testing.assert_allclose(found.corners, again.corners, atol=0.3)
