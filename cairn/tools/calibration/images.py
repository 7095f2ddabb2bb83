"""The images of a calibration: of which camera they are, and where they show the chessboard."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.system.files import explain_os_error
from cairn.vision.calibration import FEWEST
from cairn.vision.chessboard import Board, find_corners, find_other_board
from cairn.vision.image_files import assign_cameras, images_in, natural_order
from cairn.vision.images import read_image

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

# Images in which boards of other sizes are searched, which is slow.
_SEARCHED_IMAGES = 2
_MOST_NAMES = 6


@dataclass(frozen=True)
class CalibrationImages:
    """The images of the left or only camera, and those of the right camera, if there is one."""

    left: list[Path]
    right: list[Path]


def find_images(
    images: Sequence[str], left: Sequence[str], right: Sequence[str]
) -> CalibrationImages:
    """Find the images of each camera by files, folders and patterns.

    `images` of two cameras are separated by their names (`assign_cameras`); otherwise all are of
    one camera. Raises `CairnError` if a file is missing, or if the camera of a file is unknown.
    """
    ours, theirs, others = _files(left), _files(right), _files(images)
    if bool(left) != bool(right):
        raise CairnError(
            f"--{'left' if left else 'right'} is given without the other; give images of both "
            "cameras, or those of one camera without an option"
        )
    sides = assign_cameras(others)
    two = bool(left) or {"left", "right"} <= set(sides.values())
    if not two:
        return CalibrationImages(others, [])
    for path, side in sides.items():
        if side is None:
            raise CairnError(
                f"{path} has neither left nor right in its name, so its camera is unknown; "
                "give folders or quoted patterns, --left 'a/*' --right 'b/*'"
            )
    ours += [path for path, side in sides.items() if side == "left"]
    theirs += [path for path, side in sides.items() if side == "right"]
    return CalibrationImages(
        sorted(set(ours), key=natural_order), sorted(set(theirs), key=natural_order)
    )


def _files(given: Sequence[str]) -> list[Path]:
    found: list[Path] = []
    for text in given:
        try:
            found += _expand(text)
        except OSError as error:
            raise CairnError(f"{text}: {explain_os_error(error)}.") from error
    return list(dict.fromkeys(found))


def _expand(text: str) -> list[Path]:
    path = Path(text)
    if path.is_dir():
        return images_in(path)
    if path.exists():
        return [path]
    if not glob.has_magic(text):
        raise CairnError(f"{text}: no such file or folder.")
    matched = [Path(name) for name in glob.glob(text)]
    if not matched:
        raise CairnError(f"{text}: no file matches this pattern.")
    return sorted(matched, key=natural_order)


@dataclass(frozen=True)
class BoardCorners:
    """The board's `corners` (n, 2) [px] by image name, and the images `without` the board.

    All images have one `size` [px].
    """

    size: tuple[int, int]
    corners: Mapping[str, Array]
    without: Sequence[str]


def find_board(board: Board, files: Sequence[Path]) -> BoardCorners:
    """Find the board's corners in the image files of one camera.

    Raises `CairnError` if a file is not an image, sizes differ, fewer than three images show the
    board, or the board has more corners than `board`.
    """
    if len(files) < FEWEST:
        raise CairnError(
            f"{len(files)} image{'' if len(files) == 1 else 's'} of a camera; a calibration needs "
            f"at least {FEWEST}, and 10 to be good"
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
            without[name] = image if len(without) < _SEARCHED_IMAGES else None
        else:
            corners[name] = found
            with_board += [image] if len(with_board) < _SEARCHED_IMAGES else []
    size = _common_size(sizes)
    if len(corners) < FEWEST:
        other = find_other_board([image for image in without.values() if image is not None], board)
        remedy = (
            f"a board of {other} was found; give --board {other} if that is the board (count inner "
            "corners, not squares)"
            if other
            else "check that --board counts inner corners, and that the board is complete, sharp "
            "and has a white border"
        )
        raise CairnError(
            f"a board of {board} inner corners was found in {len(corners)} of {len(files)} images, "
            f"not in {_join_names(list(without))}; {remedy}"
        )
    _check_whole(board, with_board)
    return BoardCorners(size, corners, list(without))


def _common_size(sizes: Mapping[str, tuple[int, int]]) -> tuple[int, int]:
    """Return the common width and height [px] of all images; raise `CairnError` if they differ."""
    most, _ = Counter(sizes.values()).most_common(1)[0]
    for name, size in sizes.items():
        if size != most:
            raise CairnError(
                f"{name} is {size[0]} x {size[1]} pixels, other images are {most[0]} x {most[1]}; "
                "give images of one camera, at one size"
            )
    return most


def _join_names(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def _check_whole(board: Board, images: Sequence[Gray]) -> None:
    """Raise `CairnError` if the images show a larger board.

    In each image another part of it could have been found.
    """
    found: Board | None = None
    for image in images:
        found = find_other_board([image], board, larger=True)
        if found is None:
            return
    raise CairnError(
        f"the board has more than {board} inner corners: one of {found} was found; give --board "
        f"{found}"
    )
