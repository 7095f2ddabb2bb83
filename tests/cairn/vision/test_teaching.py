"""Tests of the checks of pictures before they are taught."""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.vision import teaching
from cairn.vision.teaching import make_view, repeats, why_unrecognizable
from tests.cairn.vision.extracted import CachedExtract
from tests.cairn.vision.test_real_images import FILES, image_of
from tests.cairn.visual_map.views import texture
from tests.sweeps import sampled

pytestmark = pytest.mark.images


REAL = [name for name in FILES if name != "chessboard"]


@pytest.fixture(autouse=True, scope="module")
def extracted_once() -> Iterator[None]:
    """Extract the features of each image once: that takes most of the time of these tests."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(teaching, "extract", CachedExtract())
        yield


def tiled(tile: NDArray[np.uint8], rows: int, columns: int) -> NDArray[np.uint8]:
    """Return a picture of repeated tiles with a camera's noise."""
    picture = np.tile(tile, (rows, columns))
    noise = np.random.default_rng(1).normal(0, 2, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("rows", "columns"), [(1, 2), (2, 2), (3, 4), (6, 6)])
@pytest.mark.parametrize("seed", sampled([1, 2]))
def test_picture_of_tiles_repeats_itself(seed: int, rows: int, columns: int) -> None:
    tile = texture(seed, 120, 90)

    assert repeats(make_view(tiled(tile, rows, columns)))
    assert not repeats(make_view(tiled(tile, 1, 1)))


@pytest.mark.parametrize("name", sampled(REAL, 3))
def test_photograph_is_recognizable_and_does_not_repeat(name: str) -> None:
    view = make_view(image_of(name))

    assert why_unrecognizable(view) == ""
    assert not repeats(view)


def test_blank_picture_does_not_repeat() -> None:
    assert not repeats(make_view(np.full((100, 100), 90, np.uint8)))
