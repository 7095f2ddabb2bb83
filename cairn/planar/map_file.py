"""Read and write grid maps as ROS's map_server files: a YAML file and an image."""

from __future__ import annotations

import math
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from cairn.errors import CairnError
from cairn.limits.images import decode_image, look_up, read_image_file
from cairn.limits.yaml import no_boolean, read_yaml, yaml_fault
from cairn.planar.grid import (
    FREE,
    FREE_TO,
    OCCUPIED,
    OCCUPIED_FROM,
    UNKNOWN,
    Frame,
    Grid,
    OccupancyCells,
)
from cairn.schemas.nav_msgs import LARGEST_ORIGIN, SMALLEST_CELL
from cairn.system.files import complete_replacement, explain_os_error, replace_file

Mode = Literal["trinary", "scale", "raw"]


def _as_bool(value: object) -> object:
    return {0: False, 1: True}.get(value, value) if isinstance(value, int) else value


def _three_numbers(value: object) -> object:
    """Return the three numbers of an origin; Python writes (1.0, 2.0, 0.0), which is a text."""
    if isinstance(value, str) and value.startswith("(") and value.endswith(")"):
        value = [float(part) for part in value[1:-1].split(",")]
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError("must be [x, y, yaw] in m and rad; yaw is 0 if the map is not rotated")
    return value


Number = Annotated[float, BeforeValidator(no_boolean)]
Coordinate = Annotated[
    float, Field(ge=-LARGEST_ORIGIN, le=LARGEST_ORIGIN), BeforeValidator(no_boolean)
]


class MapFile(BaseModel):
    """The keys of the YAML file, as in map_server's documentation; other keys are ignored."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    image: Path
    mode: Mode = "trinary"
    resolution: Number = Field(ge=SMALLEST_CELL, le=100)
    origin: Annotated[tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(_three_numbers)]
    negate: Annotated[bool, BeforeValidator(_as_bool)] = False
    occupied_thresh: Number = Field(gt=0, le=1)
    free_thresh: Number = Field(ge=0, lt=1)
    strict_thresholds: bool = Field(
        False,
        description="Whether free_thresh decides also about the gray that map_saver writes for "
        "unknown cells. Only Cairn knows this key.",
    )
    width: int | None = Field(None, gt=0, description="Width the image must have [pixels].")
    height: int | None = Field(None, gt=0, description="Height the image must have [pixels].")


_SAVER_UNKNOWN = 205
_SAVER_OTHERS = {0, 254, 255}
"""The grays that map_saver and slam_toolbox write for unknown cells, and for all others."""


def read_map(file: Path, notify: Callable[[str], object] = lambda _: None) -> OccupancyCells:
    """Read a map from a YAML file and the image that it names; row 0 is the image's bottom row.

    A pixel's lightness (mean of its colors) gives the probability p of an obstacle: dark is
    occupied, unless `negate`. The modes are:

    - trinary: occupied above occupied_thresh, free below free_thresh, otherwise unknown. The gray
      205 of a map_saver, whose own `free_thresh` of 0.25 would make it free, is unknown, too,
      unless `strict_thresholds`; `notify` gets a note;
    - scale: p between the thresholds in percent, unknown where the image is transparent;
    - raw: the pixel's value is the cell's, above 100 unknown.

    Raises `CairnError` with file, value and remedy.
    """
    description = _read_description(file)
    path = file.parent / description.image
    levels, lightness, opaque = _pixels(path)
    _check_size(file, path, description, levels)
    if description.mode == "raw":
        cells = look_up(_raw_cells(lightness), levels)
    else:
        occupied = lightness if description.negate else 1.0 - lightness
        values = _cells(occupied, description)
        unknown = _saved_as_unknown(description, levels, lightness)
        if np.any(values[unknown] == FREE):
            values[unknown] = UNKNOWN
            notify(
                f"{file}: pixels of gray {_SAVER_UNKNOWN} are unknown, as its image is one of "
                f"map_saver; by the letter, free_thresh = {description.free_thresh:g} makes them "
                "free: for that, add strict_thresholds: true"
            )
        cells = look_up(values, levels)
        if description.mode == "scale" and opaque is not None:
            cells[~opaque] = UNKNOWN
        elif opaque is not None and not opaque.all():
            notify(
                f"{file}: {np.mean(~opaque):.0%} of the pixels are transparent, and count by their "
                f"hidden color in mode {description.mode}: draw them on white, or set mode: scale"
            )
    x, y, yaw = description.origin
    return Grid(np.ascontiguousarray(cells[::-1]), Frame(description.resolution, (x, y, yaw)))


def write_map(file: Path, grid: OccupancyCells, mode: Mode = "trinary") -> None:
    """Write a map as YAML file `file` and a PGM (raw, trinary) or PNG (scale) beside it.

    Each file is replaced atomically. A map that was read in a mode is written identically in that
    mode; trinary keeps only free, occupied and unknown. Raises `CairnError` if a file cannot be
    written.
    """
    image = file.with_suffix(".png" if mode == "scale" else ".pgm")
    values = grid.values[::-1]
    unknown = values == UNKNOWN
    if mode == "raw":
        picture = Image.fromarray(values.astype(np.uint8))  # UNKNOWN, -1, becomes 255
    elif mode == "scale":
        light = np.rint(255.0 * (1.0 - np.clip(values, 0, 100) / 100.0)).astype(np.uint8)
        picture = Image.fromarray(np.dstack((light, np.where(unknown, 0, 255).astype(np.uint8))))
    else:
        light = np.full(values.shape, 205, np.uint8)
        light[(values >= FREE) & (values <= FREE_TO)] = 254
        light[values >= OCCUPIED_FROM] = 0
        picture = Image.fromarray(light)
    # Encoded in memory first: Pillow does not report a file that a full disk has truncated.
    encoded = BytesIO()
    picture.save(encoded, format="PNG" if mode == "scale" else "PPM")
    text = yaml.safe_dump(
        {
            "image": image.name,
            "mode": mode,
            "resolution": grid.frame.resolution,
            "origin": list(grid.frame.origin),
            "negate": 0,
            "occupied_thresh": 1.0 if mode == "scale" else OCCUPIED_FROM / 100,
            "free_thresh": 0.0 if mode == "scale" else 0.196,
            "width": values.shape[1],
            "height": values.shape[0],
        },
        sort_keys=False,
    )
    try:
        replace_file(image, encoded.getvalue())
        replace_file(file, text.encode())
    except OSError as error:
        raise CairnError(
            f"{file}: the map cannot be written: {explain_os_error(error, file)}, or choose "
            "another folder"
        ) from error


def _read_description(file: Path) -> MapFile:
    complete_replacement(file)
    try:
        content = read_yaml(file)
    except FileNotFoundError as error:
        raise CairnError(f"{file}: no such file; give the YAML file of a map_server map") from error
    except OSError as error:
        raise CairnError(f"{file}: cannot be read: {explain_os_error(error)}") from error
    except UnicodeDecodeError as error:
        raise CairnError(
            f"{file}: not a map_server YAML file: {error}; save it as UTF-8"
        ) from error
    except yaml.YAMLError as error:
        position, fault = yaml_fault(error)
        raise CairnError(f"{file}{position}: not a map_server YAML file: {fault}") from error
    if not isinstance(content, dict):
        raise CairnError(f"{file}: not a map_server YAML file: it has no keys")
    try:
        description = MapFile.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        given = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise CairnError(f"{file}: {key}{given}: {first['msg'].lower()}; correct it") from error
    if description.free_thresh >= description.occupied_thresh:
        raise CairnError(
            f"{file}: free_thresh = {description.free_thresh} is not below occupied_thresh = "
            f"{description.occupied_thresh}; lower free_thresh"
        )
    if not all(math.isfinite(value) for value in description.origin):
        raise CairnError(
            f"{file}: origin = {description.origin} is not finite; give three finite numbers"
        )
    return description


def _pixels(
    path: Path,
) -> tuple[NDArray[np.unsignedinteger[Any]], NDArray[np.float64], NDArray[np.bool_] | None]:
    """Return the sum of the colors (rows, columns), the lightness 0 to 1 of each sum, and opacity.

    The lightness is a table, because an image has few different sums and may have many pixels.
    """
    if not path.exists():
        raise CairnError(f"{path}: no such image; correct `image` in the map's YAML file")
    _, pixels = decode_image(str(path), read_image_file(path))
    white = int(np.iinfo(pixels.dtype).max)
    opaque, colors = None, 1
    if pixels.ndim == 3:
        if pixels.shape[2] in (2, 4):
            opaque, pixels = pixels[..., -1] > 0, pixels[..., :-1]
        colors = pixels.shape[2]
        pixels = np.add.reduce(pixels, axis=2, dtype=np.uint32 if white > 255 else np.uint16)
    return pixels, np.arange(colors * white + 1) / colors / white, opaque


def _saved_as_unknown(
    description: MapFile, levels: NDArray[Any], lightness: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which sums of colors a program has written for unknown cells in mode `trinary`."""
    grays = np.rint(255.0 * lightness)
    found = np.zeros(lightness.shape, bool)
    if description.mode == "trinary" and not (description.negate or description.strict_thresholds):
        for row in levels:
            found[row] = True
    if not set(grays[found]) <= _SAVER_OTHERS | {_SAVER_UNKNOWN}:
        found[:] = False  # a drawing, or a picture
    unknown: NDArray[np.bool_] = found & (grays == _SAVER_UNKNOWN)
    return unknown


def _check_size(file: Path, path: Path, description: MapFile, pixels: NDArray[Any]) -> None:
    height, width = pixels.shape
    for name, expected, actual in (
        ("width", description.width, width),
        ("height", description.height, height),
    ):
        if expected is not None and expected != actual:
            raise CairnError(
                f"{file}: {name} = {expected}, but {path} is {width} x {height} pixels; correct one"
            )


def _raw_cells(lightness: NDArray[np.float64]) -> NDArray[np.int8]:
    """Return the cell values of pixels with these degrees of lightness, in mode `raw`."""
    values = np.rint(255.0 * lightness)
    return np.where(values > OCCUPIED, UNKNOWN, values).astype(np.int8)


def _cells(occupied: NDArray[np.float64], description: MapFile) -> NDArray[np.int8]:
    """Return the cell values of these probabilities of an obstacle."""
    cells = np.full(occupied.shape, UNKNOWN, np.int8)
    least, most = description.free_thresh, description.occupied_thresh
    if description.mode == "scale":
        share = (occupied - least) / (most - least)
        between = np.rint(1.0 + 98.0 * np.clip(share, 0.0, 1.0))
        if least == 0.0 and most == 1.0:
            between = np.rint(100.0 * occupied)
        cells = np.clip(between, FREE, OCCUPIED).astype(np.int8)
    cells[occupied > most] = OCCUPIED
    cells[occupied < least] = FREE
    return cells
