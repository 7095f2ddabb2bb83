"""Tests of feature extraction."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.vision.features import LARGEST, extract, select_across_scales
from tests.cairn.visual_map.views import texture

pytestmark = pytest.mark.images


PICTURE = texture(1, 320, 240)


def nearest(
    points: NDArray[np.float32], others: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    distances = np.linalg.norm(points[:, None] - others[None], axis=2)
    return distances.argmin(axis=1), distances.min(axis=1)


def test_extraction_is_deterministic() -> None:
    one, other = extract(PICTURE), extract(PICTURE.copy())

    assert len(one) > 100
    assert np.array_equal(one.points, other.points)
    assert np.array_equal(one.scales, other.scales)
    assert np.array_equal(one.angles, other.angles)
    assert np.array_equal(one.descriptors, other.descriptors)


def test_origin_is_the_center_of_the_top_left_pixel() -> None:
    mirrored = extract(np.ascontiguousarray(PICTURE[:, ::-1]))
    back = mirrored.points * [-1, 1] + [PICTURE.shape[1] - 1, 0]

    match, distances = nearest(extract(PICTURE).points, back.astype(np.float32))

    same = distances < 1.0
    assert same.mean() > 0.8
    offsets = extract(PICTURE).points[same] - back[match[same]]
    # Any constant offset from the middle of a pixel would show twice here.
    assert np.abs(np.median(offsets, axis=0)).max() < 0.05


def test_descriptors_have_equal_length() -> None:
    lengths = np.linalg.norm(extract(PICTURE).descriptors.astype(np.float64), axis=1)

    assert np.abs(lengths / 512 - 1).max() < 0.05


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (1, 7), (7, 1), (5, 5), (1, 50_000)])
def test_tiny_images_are_accepted(shape: tuple[int, int]) -> None:
    assert len(extract(np.zeros(shape, np.uint8))) == 0


@pytest.mark.parametrize("level", [0, 128, 255])
def test_plain_image_has_no_features(level: int) -> None:
    features = extract(np.full((120, 160), level, np.uint8))

    assert len(features) == 0
    assert features.points.shape == (0, 2)
    assert features.descriptors.shape == (0, 128)


def test_huge_image_is_scaled_down_and_features_keep_its_coordinates() -> None:
    factor = 9
    huge = np.kron(PICTURE, np.ones((factor, factor), np.uint8))
    assert huge.size > 2 * LARGEST

    features = extract(huge)

    original = extract(PICTURE)
    coarse = original.scales > 6.0
    places = ((original.points[coarse] + 0.5) * factor - 0.5).astype(np.float32)
    match, distances = nearest(places, features.points)
    assert np.median(distances) < 0.2 * factor
    sizes = features.scales[match] / original.scales[coarse]
    assert np.median(sizes) == pytest.approx(factor, rel=0.1)


def test_strongest_features_come_first() -> None:
    every = extract(PICTURE)

    few = extract(PICTURE, 30)

    assert len(few) == 30
    assert np.array_equal(few.points, every.points[:30])
    assert np.array_equal(few.descriptors, every.descriptors[:30])


def test_selected_features_are_of_all_scales() -> None:
    every = extract(PICTURE)

    few = select_across_scales(every, 60)

    assert len(few) == 60
    coarse = (every.scales >= 16).sum()
    assert coarse > 0
    assert (few.scales >= 16).sum() > 0.7 * coarse
    assert (every.at(np.arange(60)).scales >= 16).sum() < 0.4 * coarse


@pytest.mark.parametrize("image", [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32)])
def test_array_that_is_not_a_gray_image_is_rejected(image: NDArray[np.uint8]) -> None:
    with pytest.raises(ValueError, match="uint8"):
        extract(image)


@pytest.mark.parametrize("light", [0.5, 0.2])
def test_dark_picture_keeps_most_features(light: float) -> None:
    dark = (PICTURE * light).astype(np.uint8)

    assert len(extract(dark)) > 0.7 * len(extract(PICTURE))
