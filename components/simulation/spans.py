"""What fills a part of one column of an image: a side, a level plane, or one gray.

Columns are painted from front to back: `value` (h,) is what has come together, and `left` (h,) the
share of each pixel that nothing in front covers yet.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.atlas import PATTERN, TEXEL_M
from cairn.components.simulation.textures import PATTERN_TEXELS
from cairn.planar.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Float32 = NDArray[np.float32]

TEXELS_PER_M = 1.0 / TEXEL_M
_FURTHEST_M = 200.0
# Light on a plane is worked out every so many rows.
_BLOCK = 16
_COARSEST = int(math.log2(PATTERN_TEXELS)) - 1


@compiled()
def _way(seen: Array, i: int, u: float) -> float:
    """The way along a surface [m] where column `u` [px] meets it, or its end."""
    share = max(0.0, min(1.0, (u - seen[i, 0]) / (seen[i, 1] - seen[i, 0])))
    over: float = seen[i, 4] + share * (seen[i, 5] - seen[i, 4])
    deep: float = seen[i, 2] + share * (seen[i, 3] - seen[i, 2])
    return over / deep


@compiled()
def _cut(
    sums: Float32,
    begin: int,
    columns: int,
    rows: int,
    repeats: bool,
    x_a: float,
    x_b: float,
    size: int,
    strip: Array,
) -> None:
    """The sums down a strip of a texture between two places across it [texels]."""
    wide = x_b - x_a
    if wide < 1.0:
        x_a, wide = x_a + 0.5 * wide - 0.5, 1.0
    if repeats:
        wide = min(wide, 1.0 * columns)
        x_a -= columns * math.floor(x_a / columns)
        x_b = x_a + wide
    else:
        x_b = min(x_a + wide, 1.0 * columns)
        x_a = max(0.0, min(x_a, columns - 0.5))
        x_b = max(x_b, x_a + 0.5)
        wide = x_b - x_a
    last = 2 * columns - 1 if repeats else columns - 1
    a, b = min(int(x_a), last), min(int(x_b), last)
    rest_a, rest_b = x_a - a, x_b - b
    at_a, at_b = begin + a * rows, begin + b * rows
    scale = 1.0 / wide
    total = 0.0
    strip[0] = 0.0
    for y in range(min(size, rows)):
        below_a, below_b = sums[at_a + y], sums[at_b + y]
        to_a = below_a + rest_a * (sums[at_a + rows + y] - below_a)
        to_b = below_b + rest_b * (sums[at_b + rows + y] - below_b)
        total += scale * (to_b - to_a)
        strip[y + 1] = total
    for y in range(rows, size):
        strip[y + 1] = strip[y + 1 - rows] + strip[rows]
    strip[size + 1] = strip[size]


@compiled()
def _sum_to(strip: Array, y: float) -> float:
    """The sum down to a place between two texels."""
    row = int(y)
    below: float = strip[row]
    texel: float = strip[row + 1] - below
    return below + (y - row) * texel


@compiled()
def _texel(levels: Float32, begin: int, size: int, x: float, y: float) -> float:
    """The pattern at a place [texels], between the four nearest of the level that begins there."""
    column, row = math.floor(x), math.floor(y)
    rest_x, rest_y = x - column, y - row
    left, right = column & (size - 1), (column + 1) & (size - 1)
    upper, lower = begin + (row & (size - 1)) * size, begin + ((row + 1) & (size - 1)) * size
    above = levels[upper + left] + rest_x * (levels[upper + right] - levels[upper + left])
    below = levels[lower + left] + rest_x * (levels[lower + right] - levels[lower + left])
    return float(above + rest_y * (below - above))


@compiled()
def flat(value: Array, left: Array, first: float, last: float, opacity: float, gray: float) -> None:
    """Rows from `first` to `last` [px] in one gray, through which the rest shines."""
    top, bottom = max(0, math.floor(first + 0.5)), min(len(value) - 1, int(last + 0.5))
    for r in range(top, bottom + 1):
        cover = min(r + 0.5, last) - max(r - 0.5, first)
        part = max(0.0, cover) * opacity * left[r]
        value[r] += part * gray
        left[r] -= part


@compiled()
def side(
    seen: Array,
    i: int,
    begin: float,
    end: float,
    depth: float,
    first: float,
    last: float,
    below: float,
    surface: int,
    scales: Array,
    gray: float,
    kinds: Integers,
    sums: Float32,
    begins: Integers,
    shapes: Integers,
    lens: Array,
    strip: Array,
    value: Array,
    left: Array,
) -> None:
    """The part of an upright surface between the columns `begin` and `end` [px]."""
    height = len(value)
    top, bottom = max(0, math.floor(first + 0.5)), min(height - 1, int(last + 0.5))
    if bottom < top:
        return
    texture = kinds[surface, 1]
    columns, rows = shapes[texture, 0], shapes[texture, 1]
    repeats = texture == PATTERN
    x_a = scales[surface, 2] + scales[surface, 0] * _way(seen, i, begin)
    x_b = scales[surface, 2] + scales[surface, 0] * _way(seen, i, end)
    step = depth / lens[1] * scales[surface, 1]
    base = (below + (top - 0.5 - lens[3]) / lens[1] * depth) * scales[surface, 1]
    size = rows
    if repeats:
        size = min(len(strip) - 2, int(base + step * (bottom - top + 1)) + 2)
    _cut(sums, begins[texture], columns, rows, repeats, min(x_a, x_b), max(x_a, x_b), size, strip)
    wide = max(step, 1.0)
    base += 0.5 * (step - wide)
    for r in range(top, bottom + 1):
        if left[r] <= 0.0:
            continue
        lower = base + (r - top) * step
        upper = lower + wide
        if lower >= 0.0 and upper <= size:
            mean = (_sum_to(strip, upper) - _sum_to(strip, lower)) / wide
        else:
            lower, upper = max(0.0, min(lower, size - 0.5)), max(0.5, min(upper, 1.0 * size))
            mean = (_sum_to(strip, upper) - _sum_to(strip, lower)) / (upper - lower)
        part = left[r]
        if not top < r < bottom:
            part *= max(0.0, min(r + 0.5, last) - max(r - 0.5, first))
        value[r] += part * gray * mean
        left[r] -= part


@compiled()
def light_at(x: float, y: float, spread: float) -> float:
    """How light it is at a place: lamps are some meters apart."""
    return 1.0 + spread * math.sin(1.1 * x + 0.7) * math.sin(0.9 * y + 1.9)


@compiled()
def plane(
    value: Array,
    left: Array,
    first: float,
    last: float,
    away: float,
    gray: float,
    contrast: float,
    spread: float,
    right: float,
    camera: Array,
    unit: Array,
    coarse: Array,
    levels: Float32,
    level_begins: Integers,
) -> None:
    """Rows from `first` to `last` [px] of a level plane `away` [m] below or above the camera."""
    top, bottom = max(0, math.floor(first + 0.5)), min(len(value) - 1, int(last + 0.5))
    ahead_x, ahead_y = camera[3] + right * camera[4], camera[4] - right * camera[3]
    coarser = math.log2(max(away, 1e-3))
    for begin in range(top, bottom + 1, _BLOCK):
        end = min(begin + _BLOCK, bottom + 1)
        depth, further = (
            min(away * unit[begin], _FURTHEST_M),
            min(away * unit[end - 1], _FURTHEST_M),
        )
        light = gray * light_at(camera[0] + depth * ahead_x, camera[1] + depth * ahead_y, spread)
        step = gray * light_at(camera[0] + further * ahead_x, camera[1] + further * ahead_y, spread)
        step = (step - light) / max(1, end - 1 - begin)
        level = int(min(max(coarse[(begin + end) // 2] + coarser + 0.5, 0.0), _COARSEST))
        at, size = level_begins[level], PATTERN_TEXELS >> level
        per_m = TEXELS_PER_M / (1 << level)
        begin_x, begin_y = per_m * camera[0] - 0.5, per_m * camera[1] - 0.5
        step_x, step_y = per_m * away * ahead_x, per_m * away * ahead_y
        for r in range(begin, end):
            if left[r] <= 0.0:
                continue
            x, y = begin_x + unit[r] * step_x, begin_y + unit[r] * step_y
            part = left[r]
            if not top < r < bottom:
                part *= max(0.0, min(r + 0.5, last) - max(r - 0.5, first))
            texel = 1.0 + contrast * (_texel(levels, at, size, x, y) - 1.0)
            value[r] += part * (light + step * (r - begin)) * texel
            left[r] -= part
