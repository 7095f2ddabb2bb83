"""What is odd about a picture that is to be taught is noticed."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.vision.teaching import repeats, unfit, view_of
from tests.cairn.vision.taught_objects import texture
from tests.cairn.vision.test_real_images import FILES, image_of

pytestmark = pytest.mark.images


REAL = [name for name in FILES if name != "chessboard"]


def tiled(tile: NDArray[np.uint8], rows: int, columns: int) -> NDArray[np.uint8]:
    """The tile again and again, and the camera's noise."""
    picture = np.tile(tile, (rows, columns))
    noise = np.random.default_rng(1).normal(0, 2, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("rows", "columns"), [(1, 2), (2, 2), (3, 4), (6, 6)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_picture_of_tiles_is_in_itself_again(seed: int, rows: int, columns: int) -> None:
    tile = texture(seed, 120, 90)

    assert repeats(view_of(tiled(tile, rows, columns)))
    assert not repeats(view_of(tiled(tile, 1, 1)))


@pytest.mark.parametrize("name", REAL)
def test_a_photograph_is_not(name: str) -> None:
    view = view_of(image_of(name))

    assert unfit(view) == ""
    assert not repeats(view)


def test_nor_is_one_without_anything_in_it() -> None:
    assert not repeats(view_of(np.full((100, 100), 90, np.uint8)))
