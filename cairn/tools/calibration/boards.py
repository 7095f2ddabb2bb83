"""The chessboard in the images of one camera: where it is seen, and why it is not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.vision.calibration import FEWEST
from cairn.vision.chessboard import Board, find_corners, other_board
from cairn.vision.images import read_image

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

# In so many images another board is looked for, which takes long.
_LOOKED_AT = 2
_NAMED = 6


@dataclass(frozen=True)
class Seen:
    """`corners` (n, 2) [px] by the image's name, images `without` the board, all of one `size`."""

    size: tuple[int, int]
    corners: Mapping[str, Array]
    without: Sequence[str]


def look_for(board: Board, files: Sequence[Path]) -> Seen:
    """The board's corners in image files of one camera.

    Raises `CairnError` if a file is no image, sizes differ, fewer than three show the board, or it
    has more corners than `board` says.
    """
    if len(files) < FEWEST:
        raise CairnError(
            f"{len(files)} image{'' if len(files) == 1 else 's'} of a camera: a calibration needs "
            f"{FEWEST} at least, and 10 to be good"
        )
    sizes: dict[str, tuple[int, int]] = {}
    corners: dict[str, Array] = {}
    with_board: list[Gray] = []
    without: dict[str, Gray | None] = {}
    for file in files:
        image, name = read_image(file), str(file)
        sizes[name] = (image.shape[1], image.shape[0])
        found = find_corners(image, board)
        if found is None:
            without[name] = image if len(without) < _LOOKED_AT else None
        else:
            corners[name] = found
            with_board += [image] if len(with_board) < _LOOKED_AT else []
    size = _size(sizes)
    if len(corners) < FEWEST:
        seen = other_board([image for image in without.values() if image is not None], board)
        remedy = (
            f"one of {seen} was found: is that the board (inner corners count, not squares)?"
            if seen
            else "does --board count its inner corners, is it seen whole, sharp and with a white "
            "border?"
        )
        raise CairnError(
            f"a board of {board} inner corners is seen in {len(corners)} of {len(files)} images, "
            f"not in {_listed(list(without))}; {remedy}"
        )
    _check_whole(board, with_board)
    return Seen(size, corners, list(without))


def _size(sizes: Mapping[str, tuple[int, int]]) -> tuple[int, int]:
    """Width and height [px] that all images have."""
    most, _ = Counter(sizes.values()).most_common(1)[0]
    for name, size in sizes.items():
        if size != most:
            raise CairnError(
                f"{name} is {size[0]} x {size[1]} pixels, other images are {most[0]} x {most[1]}: "
                "take images of one camera, at one size"
            )
    return most


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _check_whole(board: Board, images: Sequence[Gray]) -> None:
    """Of a larger board any part could have been taken, in each image another."""
    found: Board | None = None
    for image in images:
        found = other_board([image], board, larger=True)
        if found is None:
            return
    raise CairnError(
        f"the board has more than {board} inner corners: one of {found} was found; give all of "
        "them with --board"
    )
