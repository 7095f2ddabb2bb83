"""A scan drawn in characters, for terminals: Braille cells, which have 2 by 4 dots each."""

from __future__ import annotations

import math

import numpy as np

from cairn.schemas.sensor_msgs import LaserScan

_ACROSS, _DOWN = 2, 4  # dots of a cell
# Bits of Unicode's Braille patterns, row by row.
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_EMPTY = 0x2800
_ROBOT = "+"
_SHARE = 0.98  # of the ranges that the picture shows, unless it is told what it reaches


def drawn(scan: LaserScan, size: tuple[int, int], reach: float | None = None) -> tuple[str, float]:
    """What a scan hit, seen from above, ahead up, the scanner in the middle; and its reach [m].

    `size`: columns and lines of the picture. Without `reach` [m] it shows nearly all that was hit.
    """
    columns, lines = size
    angles = scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size)
    hit = np.isfinite(scan.ranges)
    ranges, angles = scan.ranges[hit], angles[hit]
    if reach is None:
        reach = 1.05 * float(np.quantile(ranges, _SHARE)) if ranges.size else scan.range_max
    # A dot is as wide as high in most terminals: a cell is twice as high as wide.
    dots = np.array([columns * _ACROSS, lines * _DOWN])
    meter = 0.5 * (dots.min() - 1) / reach
    across = np.rint(0.5 * (dots[0] - 1) - meter * ranges * np.sin(angles)).astype(int)
    down = np.rint(0.5 * (dots[1] - 1) - meter * ranges * np.cos(angles)).astype(int)
    inside = (across >= 0) & (across < dots[0]) & (down >= 0) & (down < dots[1])
    across, down = across[inside], down[inside]
    cells = np.zeros((lines, columns), int)
    np.bitwise_or.at(
        cells, (down // _DOWN, across // _ACROSS), _BITS[down % _DOWN, across % _ACROSS]
    )
    text = [[chr(_EMPTY + cell) for cell in row] for row in cells.tolist()]
    text[lines // 2][columns // 2] = _ROBOT
    return "\n".join("".join(row) for row in text), math.ceil(reach * 100) / 100
