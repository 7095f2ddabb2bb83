"""Image files in folders: in what order, and which of the left and which of the right camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cairn.errors import CairnError
from cairn.vision.file_errors import why

Side = Literal["left", "right"]

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
"""How names of images end."""

# `left` and `right` as a word of their own: left01, img_left, LeftImage; not bright, not leftover.
_SIDE = re.compile(
    r"(?<![A-Za-z])(left|right|Left|Right|LEFT|RIGHT)(?![a-z])|(?<=[a-z0-9])(Left|Right)(?![a-z])"
)
# cam0, Camera_1, cam-2; not webcam0.
_CAMERA = re.compile(r"(?<![a-z])cam(?:era)?[_-]?([0-9]+)", re.IGNORECASE)


@dataclass(frozen=True)
class Pairs:
    """Left and right files that belong together, in order, and `alone` those that have no other."""

    pairs: tuple[tuple[Path, Path], ...]
    alone: tuple[Path, ...]


def images_in(folder: Path) -> list[Path]:
    """The images of a folder in natural order, or of its folders of a camera each.

    Those are `left` and `right`, or cameras with numbers such as `cam0` and `cam1`. Raises
    `CairnError` if it cannot be read or holds none.
    """
    try:
        children = list(folder.iterdir())
        for child in [child for child in children if is_of_camera(child)]:
            children += child.iterdir()
    except OSError as error:
        raise CairnError(f"{folder} cannot be read: {why(error)}.") from error
    found = [child for child in children if child.suffix.lower() in SUFFIXES and child.is_file()]
    if not found:
        raise CairnError(f"{folder} holds no images (files that end in {', '.join(SUFFIXES)}).")
    return sorted(found, key=lambda path: (path.parent.name, natural(path)))


def is_of_camera(folder: Path) -> bool:
    """Whether it is a folder that by its name holds what one of several cameras took."""
    named = folder.name in ("left", "right") or _CAMERA.fullmatch(folder.name)
    return bool(named) and folder.is_dir()


def sides_of(paths: Iterable[Path]) -> dict[Path, Side | None]:
    """The camera of each file: by the words `left` and `right`, else by two cameras' numbers.

    Of two numbers, as in cam0 and cam1, the lower one is the left camera's. Numbers in names of
    files that are none or more than two are of a series that one camera took. Raises `CairnError`
    if files are in folders of more than two cameras.
    """
    words = {path: side_of(path) for path in paths}
    if any(words.values()):
        return words
    numbers = {path: _number(path.stem) for path in words}
    if set(numbers.values()) == {None}:
        numbers = {path: _number(path.parent.name) for path in words}
        if len(set(numbers.values())) > 2:
            folders = sorted({path.parent for path in words}, key=natural)
            raise CairnError(
                f"{', '.join(map(str, folders))} are folders of more than two cameras: give those "
                "of one or two"
            )
    cameras = set(numbers.values())
    if len(cameras) != 2 or None in cameras:
        return words
    first = min(number for number in numbers.values() if number is not None)
    return {path: "left" if number == first else "right" for path, number in numbers.items()}


def side_of(path: Path) -> Side | None:
    """The camera that a file's name tells by a word, else its folder's; None if neither does."""
    for name in (path.stem, path.parent.name):
        sides = {(match[1] or match[2]).lower() for match in _SIDE.finditer(name)}
        if len(sides) == 1:
            return "left" if "left" in sides else "right"
    return None


def paired(left: Iterable[Path], right: Iterable[Path]) -> Pairs:
    """Pairs of files whose names are the same but for what tells the camera, in natural order.

    That is `left` and `right`, or without such words the number after `cam`. Where files of one
    camera in several folders have the same name, those of a pair have the same folders, too.
    Natural order counts: frame9 comes before frame10. Raises `CairnError` if a camera has two files
    of one name all the same.
    """
    sides = list(left), list(right)
    try:
        ours, theirs = (_by_key(side, _without_side) for side in sides)
    except CairnError:
        ours, theirs = (_by_key(side, _with_folders) for side in sides)
    pairs = [(path, theirs[key]) for key, path in ours.items() if key in theirs]
    alone = [path for key, path in ours.items() if key not in theirs]
    alone += [path for key, path in theirs.items() if key not in ours]
    return Pairs(
        tuple(sorted(pairs, key=lambda pair: natural(pair[0]))), tuple(sorted(alone, key=natural))
    )


def natural(path: Path) -> list[tuple[int, int, str]]:
    """What to sort files by, so that numbers in their names count."""
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
                f"{other} and {file} have the same name, so it is not clear which belongs to the "
                "other camera's: give one of them, or name them differently"
            )
    return found


def _without_side(path: Path) -> str:
    return _sideless(path.stem)


def _with_folders(path: Path) -> str:
    return "/".join(_sideless(part) for part in (*path.parts[:-1], path.stem))


def _sideless(name: str) -> str:
    words = _SIDE if _SIDE.search(name) else _CAMERA
    return words.sub("", name).strip("_-. ")


def _number(name: str) -> int | None:
    found = _CAMERA.search(name)
    return int(found[1]) if found else None
