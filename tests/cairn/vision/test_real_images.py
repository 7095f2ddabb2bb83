"""Tests of recognition in real photographs."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.vision.features import Features, extract, select_across_scales
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.vision.recognition import Detection, Recognizer
from tests.sweeps import sampled

pytestmark = pytest.mark.images


DATA = Path(__file__).parents[2] / "data"

FILES = {
    name.split(".")[0]: DATA / "images" / name
    for name in (
        "blox.jpg",
        "board.jpg",
        "box.png",
        "box_in_scene.png",
        "building.jpg",
        "chessboard.png",
        "graf1.jpg",
        "graf3.jpg",
        "home.jpg",
        "tsukuba_l.png",
    )
} | {"left01": DATA / "calibration" / "left01.jpg", "aloeL": DATA / "stereo" / "aloeL.jpg"}

SAME = {frozenset(("box", "box_in_scene")), frozenset(("graf1", "graf3"))}


@cache
def image_of(name: str) -> NDArray[np.uint8]:
    image = cv2.imread(str(FILES[name]), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image.astype(np.uint8, copy=False)


@cache
def features_of(name: str) -> Features:
    """Return all features, strongest first; extraction is slow, so they are cached."""
    return extract(image_of(name))


def model(number: int, name: str) -> ObjectModel:
    picture = image_of(name)
    view = ModelView(
        picture.shape[1], picture.shape[0], select_across_scales(features_of(name), 400), picture
    )
    return ObjectModel(number, f"object {number}", None, (view,))


def detect_in(name: str, known: Recognizer, most: int = 3000) -> list[Detection]:
    height, width = image_of(name).shape
    every = features_of(name)
    return known.recognize(every.at(np.arange(min(most, len(every)))), width, height)


def test_box_is_detected_in_its_scene() -> None:
    (found,) = detect_in("box_in_scene", Recognizer([model(1, "box")]))

    # Read by eye, accurate to some pixels.
    expected = [(118, 161), (285, 175), (268, 298), (89, 272)]
    assert found.inliers > 40
    assert np.linalg.norm(found.corners - expected, axis=1).max() < 5


def test_graffiti_are_detected_from_the_side_with_their_corners() -> None:
    wall = model(1, "graf1")
    file = cv2.FileStorage(str(DATA / "images" / "H1to3p.xml"), cv2.FILE_STORAGE_READ)
    truth = file.getNode("H13").mat()

    (found,) = detect_in("graf3", Recognizer([wall]))

    expected = cv2.perspectiveTransform(wall.views[0].corners[None], truth)[0]
    assert np.linalg.norm(found.corners - expected, axis=1).max() < 8


@pytest.fixture(scope="module")
def everything() -> Recognizer:
    return Recognizer([model(n, name) for n, name in enumerate(FILES)])


@pytest.mark.accuracy
@pytest.mark.parametrize("name", sampled(FILES))
def test_different_pictures_are_never_confused(name: str, everything: Recognizer) -> None:
    names = list(FILES)
    found = detect_in(name, everything)

    claimed = {names[i] for each in found for i in (each.object_id, *each.alternatives)}
    assert name in claimed
    for other in claimed - {name}:
        assert frozenset((name, other)) in SAME


@pytest.mark.accuracy
def test_different_pictures_are_never_confused_with_a_single_model(everything: Recognizer) -> None:
    """With one model only, false matches are most likely: the background distance is unknown."""
    alone = {each.name: Recognizer([each]) for each in everything.objects}
    for n, name in enumerate(FILES):
        for m, other in enumerate(FILES):
            found = detect_in(name, alone[f"object {m}"], 1500)
            assert not found or n == m or frozenset((name, other)) in SAME, (name, other)
