"""Image files in folders: in what order, and which of the left and which of the right camera."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cairn.errors import CairnError

Side = Literal["left", "right"]

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
"""How names of images end."""

# `left` and `right` as a word of their own: left01, img_left, LeftImage; not bright, not leftover.
_SIDE = re.compile(
    r"(?<![A-Za-z])(left|right|Left|Right|LEFT|RIGHT)(?![a-z])|(?<=[a-z0-9])(Left|Right)(?![a-z])"
)


@dataclass(frozen=True)
class Pairs:
    """Left and right files that belong together, in order, and `alone` those that have no other."""

    pairs: tuple[tuple[Path, Path], ...]
    alone: tuple[Path, ...]


def images_in(folder: Path) -> list[Path]:
    """The images of a folder in natural order, or of its folders `left` and `right`.

    Raises `CairnError` if it cannot be read or holds none.
    """
    try:
        children = list(folder.iterdir())
        for name in ("left", "right"):
            if (folder / name).is_dir():
                children += (folder / name).iterdir()
    except OSError as error:
        raise CairnError(f"{folder} cannot be read: {error.strerror or error}.") from error
    found = [child for child in children if child.suffix.lower() in SUFFIXES and child.is_file()]
    if not found:
        raise CairnError(f"{folder} holds no images (files that end in {', '.join(SUFFIXES)}).")
    return sorted(found, key=lambda path: (path.parent.name, natural(path)))


def side_of(path: Path) -> Side | None:
    """The camera that a file's name tells, else its folder's; None if neither does."""
    for name in (path.stem, path.parent.name):
        sides = {(match[1] or match[2]).lower() for match in _SIDE.finditer(name)}
        if len(sides) == 1:
            return "left" if "left" in sides else "right"
    return None


def paired(left: Iterable[Path], right: Iterable[Path]) -> Pairs:
    """Pairs of files whose names are the same but for `left` and `right`, in natural order.

    Natural order counts: frame9 comes before frame10.
    """
    ours = {_without_side(path): path for path in left}
    theirs = {_without_side(path): path for path in right}
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


def _without_side(path: Path) -> str:
    return _SIDE.sub("", path.stem).strip("_-. ")
