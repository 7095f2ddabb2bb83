"""Zones of the map as cells of a grid: the window that zones lie in, and keepout zones."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from cairn.planar.grid import Frame
from cairn.planar.polygons import Cells, covered_cells
from cairn.planar.zones import points_of, zone_edges
from cairn.schemas.cairn_nav_msgs import Zone

Window = tuple[slice, slice]
"""Rows and columns of a part of a grid."""


def keepout_cells(zones: Iterable[Zone], frame: Frame, shape: tuple[int, int]) -> Cells | None:
    """Return which cells of a grid a keepout zone touches; None without such zones."""
    keepout = [zone for zone in zones if zone.kind == Zone.KEEPOUT]
    if not keepout:
        return None
    cells = np.zeros(shape, np.bool_)
    for zone in keepout:
        window = window_of([zone], frame, shape)
        if window is not None:
            cells[window] |= covered_cells(zone_edges(zone), *part_of(frame, window))
    return cells


def window_of(zones: Iterable[Zone], frame: Frame, shape: tuple[int, int]) -> Window | None:
    """Return the window with all cells of zones, None if none of them is in the grid."""
    areas = [zone for zone in zones if zone.kind != Zone.PLACE]
    if not areas:
        return None
    corners = [frame.cells(x, y) for zone in areas for x, y in points_of(zone).tolist()]
    wide = max(0.5 * zone.width for zone in areas) / frame.resolution + 1.0
    low, high = np.min(corners, axis=0) - wide, np.max(corners, axis=0) + wide
    last_row, last_column = shape
    top, bottom = max(0, math.floor(low[1])), min(last_row, math.ceil(high[1]))
    left, right = max(0, math.floor(low[0])), min(last_column, math.ceil(high[0]))
    return (slice(top, bottom), slice(left, right)) if top < bottom and left < right else None


def part_of(frame: Frame, window: Window) -> tuple[Frame, tuple[int, int]]:
    """Return the frame and the shape of a part of a grid."""
    rows, columns = window
    corner = frame.point(rows.start - 0.5, columns.start - 0.5)
    part = Frame(frame.resolution, (*corner, frame.origin[2]))
    return part, (rows.stop - rows.start, columns.stop - columns.start)
