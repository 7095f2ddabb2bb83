"""What the commands are given: map files, sizes and boxes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from cairn import CairnError
from cairn.vision.taught import View

DEFAULT_MAP = Path("visual_map.cairn")

MapFile = Annotated[
    Path | None,
    typer.Option(
        "--map",
        envvar="CAIRN_VISUAL_MAP",
        metavar="FILE",
        help=f"The visual map that holds the objects; {DEFAULT_MAP} if not given.",
    ),
]

_LARGEST_M = 100.0
# Sides of a photograph and of the object, as shares of each other.
_SLANTED, _WRONG = 1.1, 1.3


def parsed_size(text: str) -> tuple[float, float]:
    """Width and height [m] as W,H; raises `CairnError` if it is none that an object has."""
    try:
        width, height = (float(part) for part in text.split(","))
    except ValueError:
        width = height = math.nan
    if not (0 < width <= _LARGEST_M and 0 < height <= _LARGEST_M):
        raise CairnError(
            f"--size {text}: write it as W,H, width and height of what the image shows in meters, "
            f"above 0 and at most {_LARGEST_M:g}, such as 0.21,0.297"
        )
    return width, height


def parsed_box(text: str) -> tuple[int, int, int, int]:
    """A part of an image X,Y,W,H [px]; raises `CairnError` if it is none."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise CairnError(
            f"--box {text}: write it as X,Y,W,H in pixels, such as 120,80,200,150"
        ) from None
    return x, y, width, height


def check_shape(name: str, view: View, size: tuple[float, float]) -> str:
    """What is odd about a photograph of an object of that size, in words, or nothing.

    Raises `CairnError` if it cannot be of that size: its distance would be told wrongly.
    """
    shape, stated = view.width / view.height, size[0] / size[1]
    off = max(shape / stated, stated / shape)
    told = (
        f"{name}: the image is {shape:.2f} times as wide as high, but the size {size[0]:g} m x "
        f"{size[1]:g} m is {stated:.2f} times"
    )
    if off > _WRONG:
        raise CairnError(
            f"{told}: give width and height in this order, and an image of the object alone, from "
            "edge to edge (--box)"
        )
    return f"{told}: its distance will be less exact" if off > _SLANTED else ""
