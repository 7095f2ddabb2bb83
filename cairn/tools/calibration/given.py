"""Which images were given on the command line, and of which camera they are."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cairn import CairnError
from cairn.vision.file_errors import why
from cairn.vision.image_files import images_in, natural, sides_of


@dataclass(frozen=True)
class Given:
    """The images of the left camera, or of the only one, and those of the right camera, if any."""

    left: list[Path]
    right: list[Path]


def sorted_out(images: Sequence[str], left: Sequence[str], right: Sequence[str]) -> Given:
    """Files, folders and patterns as given, by camera.

    Names tell `images` apart if they are of two cameras (`sides_of`); else they are all of one
    camera. Raises `CairnError` if a file is missing, or names do not tell what they should.
    """
    ours, theirs, others = _files(left), _files(right), _files(images)
    if bool(left) != bool(right):
        raise CairnError(
            f"--{'left' if left else 'right'} is given without the other: give images of both "
            "cameras, or those of one without an option"
        )
    sides = sides_of(others)
    two = bool(left) or {"left", "right"} <= set(sides.values())
    if not two:
        return Given(others, [])
    for path, side in sides.items():
        if side is None:
            raise CairnError(
                f"{path} has neither left nor right in its name, so it is not clear of which "
                "camera it is: give folders or quoted patterns, --left 'a/*' --right 'b/*'"
            )
    ours += [path for path, side in sides.items() if side == "left"]
    theirs += [path for path, side in sides.items() if side == "right"]
    return Given(sorted(set(ours), key=natural), sorted(set(theirs), key=natural))


def _files(given: Sequence[str]) -> list[Path]:
    found: list[Path] = []
    for text in given:
        try:
            found += _named(text)
        except OSError as error:
            raise CairnError(f"{text}: {why(error)}.") from error
    return list(dict.fromkeys(found))


def _named(text: str) -> list[Path]:
    path = Path(text)
    if path.is_dir():
        return images_in(path)
    if path.exists():
        return [path]
    if not glob.has_magic(text):
        raise CairnError(f"{text}: no such file or folder.")
    matched = [Path(name) for name in glob.glob(text)]
    if not matched:
        raise CairnError(f"{text}: no file has such a name.")
    return sorted(matched, key=natural)
