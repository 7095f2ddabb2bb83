"""Lists image files in folders, and assigns them to left and right cameras and to pairs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cairn.errors import CairnError
from cairn.system.files import explain_os_error

Side = Literal["left", "right"]

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm")
"""Suffixes of image files that can be read."""

# `left` and `right` as separate words: left01, img_left, LeftImage; not bright, not leftover.
_SIDE = re.compile(
    r"(?<![A-Za-z])(left|right|Left|Right|LEFT|RIGHT)(?![a-z])|(?<=[a-z0-9])(Left|Right)(?![a-z])"
)
# cam0, Camera_1, cam-2; not webcam0.
_CAMERA = re.compile(r"(?<![a-z])cam(?:era)?[_-]?([0-9]+)", re.IGNORECASE)


@dataclass(frozen=True)
class FilePairs:
    """Left and right files that belong together, in order; `unpaired` files have no counterpart."""

    pairs: tuple[tuple[Path, Path], ...]
    unpaired: tuple[Path, ...]


def images_in(folder: Path) -> list[Path]:
    """Return the images of a folder and of its camera folders, in natural order.

    Camera folders are `left` and `right`, or numbered cameras such as `cam0` and `cam1`. Raises
    `CairnError` if the folder cannot be read or has no images.
    """
    try:
        children = list(folder.iterdir())
        for child in [child for child in children if is_camera_folder(child)]:
            children += child.iterdir()
    except OSError as error:
        raise CairnError(f"{folder} cannot be read: {explain_os_error(error)}.") from error
    found = [child for child in children if is_image(child)]
    if not found:
        raise CairnError(f"{folder} has no images (files that end in {', '.join(SUFFIXES)}).")
    return sorted(found, key=lambda path: (path.parent.name, natural_order(path)))


def is_image(file: Path) -> bool:
    """Return whether a file's name is that of an image; hidden ones are macOS's notes on others."""
    named = file.suffix.lower() in SUFFIXES and not file.name.startswith(".")
    return named and file.is_file()


def is_camera_folder(folder: Path) -> bool:
    """Return whether a folder's name says that it has the images of one of several cameras."""
    named = folder.name in ("left", "right") or _CAMERA.fullmatch(folder.name)
    return bool(named) and folder.is_dir()


def assign_cameras(paths: Iterable[Path]) -> dict[Path, Side | None]:
    """Return the camera of each file: by the words `left` and `right`, else by camera numbers.

    Of two numbers, as in cam0 and cam1, the lower one is the left camera. If file names have one
    number only, or more than two, all files are a series of one camera. Raises `CairnError` if the
    files are in folders of more than two cameras.
    """
    words = {path: camera_of(path) for path in paths}
    if any(words.values()):
        return words
    numbers = {path: _number(path.stem) for path in words}
    if set(numbers.values()) == {None}:
        numbers = {path: _number(path.parent.name) for path in words}
        if len(set(numbers.values())) > 2:
            folders = sorted({path.parent for path in words}, key=natural_order)
            raise CairnError(
                f"{', '.join(map(str, folders))} are folders of more than two cameras; give those "
                "of one or two"
            )
    cameras = set(numbers.values())
    if len(cameras) != 2 or None in cameras:
        return words
    first = min(number for number in numbers.values() if number is not None)
    return {path: "left" if number == first else "right" for path, number in numbers.items()}


def camera_of(path: Path) -> Side | None:
    """Return the camera by a word in the file's name, else in its folder's name, else None."""
    for name in (path.stem, path.parent.name):
        sides = {(match[1] or match[2]).lower() for match in _SIDE.finditer(name)}
        if len(sides) == 1:
            return "left" if "left" in sides else "right"
    return None


def pair_files(left: Iterable[Path], right: Iterable[Path]) -> FilePairs:
    """Pair files whose names differ only in the camera, in natural order.

    The camera is `left` or `right`, or without such words the number after `cam`. If files of one
    camera in several folders have the same name, the folders of a pair must correspond as well.
    In natural order frame9 comes before frame10. Raises `CairnError` if the files of a camera are
    still ambiguous.
    """
    sides = list(left), list(right)
    try:
        ours, theirs = (_by_key(side, lambda path: _sideless(path.stem)) for side in sides)
    except CairnError:
        ours, theirs = (_by_key(side, _with_folders) for side in sides)
    pairs = [(path, theirs[key]) for key, path in ours.items() if key in theirs]
    unpaired = [path for key, path in ours.items() if key not in theirs]
    unpaired += [path for key, path in theirs.items() if key not in ours]
    return FilePairs(
        tuple(sorted(pairs, key=lambda pair: natural_order(pair[0]))),
        tuple(sorted(unpaired, key=natural_order)),
    )


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Return a sort key for natural order: numbers in names are compared as numbers."""
    return [
        (0, int(part), "") if part.isdigit() else (1, 0, part)
        for part in re.split(r"([0-9]+)", path.name)
    ]


def _by_key(files: Iterable[Path], key_of: Callable[[Path], str]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for file in files:
        other = found.setdefault(key_of(file), file)
        if other != file:
            raise CairnError(
                f"{other} and {file} have the same name, so it is not clear which one belongs to "
                "the other camera's file; give one of them, or rename them"
            )
    return found


def _with_folders(path: Path) -> str:
    return "/".join(_sideless(part) for part in (*path.parts[:-1], path.stem))


def _sideless(name: str) -> str:
    words = _SIDE if _SIDE.search(name) else _CAMERA
    return words.sub("", name).strip("_-. ")


def _number(name: str) -> int | None:
    found = _CAMERA.search(name)
    return int(found[1]) if found else None
