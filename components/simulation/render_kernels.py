"""Kernels that render an image column by column: upright surfaces, floor, tops and ceiling.

The camera is horizontal, so each column of its image is one vertical plane of the world: the
surfaces in it are sorted by depth and painted from front to back. Pixels are means over their
areas: of textures by differences of sums, and at edges by slices of columns. While a column is
painted, `value` (h,) is the light collected so far, and `left` (h,) is the share of each pixel that
nothing in front covers yet.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.textures import PATTERN, PATTERN_TEXELS, TEXEL_M
from cairn.planar.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Float32 = NDArray[np.float32]

# Kinds of surfaces.
SIDE, GLASS, PICTURE = 0, 1, 2
# Nothing nearer than this [m] is visible.
NEAR_M = 0.05
# Pictures are drawn this far in front of their wall, and their backs behind it [m].
_BEFORE_M = 0.02
_FLOOR, _CEILING, _TOP, _BACK, _REFLECTION = 105.0, 200.0, 1.15, 90.0, 14.0
_GLASS_TINT = 0.1
TEXELS_PER_M = 1.0 / TEXEL_M
_FURTHEST_M = 200.0
# The light on a plane is computed once per this many rows.
_BLOCK = 16
_COARSEST = int(math.log2(PATTERN_TEXELS)) - 1


@compiled()
def _distance_along(seen: Array, i: int, u: float) -> float:
    """Return the distance along a surface [m] where column `u` [px] meets it."""
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
    """Fill in the sums down a strip of a texture between two positions across it [texels]."""
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
    """Return the sum down to a position between two texels."""
    row = int(y)
    below: float = strip[row]
    texel: float = strip[row + 1] - below
    return below + (y - row) * texel


@compiled()
def _texel(levels: Float32, begin: int, size: int, x: float, y: float) -> float:
    """Return the pattern at a position [texels], interpolated in the level at `begin`."""
    column, row = math.floor(x), math.floor(y)
    rest_x, rest_y = x - column, y - row
    left, right = column & (size - 1), (column + 1) & (size - 1)
    upper, lower = begin + (row & (size - 1)) * size, begin + ((row + 1) & (size - 1)) * size
    above = levels[upper + left] + rest_x * (levels[upper + right] - levels[upper + left])
    below = levels[lower + left] + rest_x * (levels[lower + right] - levels[lower + left])
    return float(above + rest_y * (below - above))


@compiled()
def flat(value: Array, left: Array, first: float, last: float, opacity: float, gray: float) -> None:
    """Paint rows `first` to `last` [px] in one gray with an opacity."""
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
    """Paint the part of an upright surface between the columns `begin` and `end` [px]."""
    height = len(value)
    top, bottom = max(0, math.floor(first + 0.5)), min(height - 1, int(last + 0.5))
    if bottom < top:
        return
    texture = kinds[surface, 1]
    columns, rows = shapes[texture, 0], shapes[texture, 1]
    repeats = texture == PATTERN
    x_a = scales[surface, 2] + scales[surface, 0] * _distance_along(seen, i, begin)
    x_b = scales[surface, 2] + scales[surface, 0] * _distance_along(seen, i, end)
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
    """Return the light at a position: lamps are some meters apart."""
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
    """Paint rows `first` to `last` [px] of a plane `away` [m] below or above the camera."""
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


@compiled(
    "Tuple((float64[:, ::1], int64[::1], float64[::1]))"
    "(float64[:, ::1], float64[::1], float64[::1], int64)"
)
def project(ends: Array, camera: Array, lens: Array, width: int) -> tuple[Array, Integers, Array]:
    """Return which surfaces a camera sees, and where.

    `ends` as in `VisibleSurfaces`; `camera` is x, y, height [m], cosine and sine of its heading;
    `lens` fx, fy, cx, cy [px]. The first result has for each visible surface the columns of its
    left and right end [px], 1 / depth [1/m] there, the distance along it / depth there, 1 if its
    first end is on the left, else 0, and its direction across and ahead (unit length). The second
    has their indices; the third all borders of slices in order: those of pixels and of surfaces.
    """
    count = len(ends)
    seen = np.empty((count, 9))
    which = np.empty(count, np.int64)
    borders = np.empty(width + 1 + 2 * count)
    for i in range(width + 1):
        borders[i] = i - 0.5
    n, b = 0, width + 1
    x, y, cosine, sine = camera[0], camera[1], camera[3], camera[4]
    for i in range(count):
        ax, ay, bx, by = ends[i, 0] - x, ends[i, 1] - y, ends[i, 2] - x, ends[i, 3] - y
        depth_a, depth_b = cosine * ax + sine * ay, cosine * bx + sine * by
        if depth_a < NEAR_M and depth_b < NEAR_M:
            continue
        right_a, right_b = sine * ax - cosine * ay, sine * bx - cosine * by
        length = math.hypot(right_b - right_a, depth_b - depth_a)
        if length <= 0.0:
            continue
        across, ahead = (right_b - right_a) / length, (depth_b - depth_a) / length
        way_a, way_b = 0.0, length
        if depth_a < NEAR_M:
            way_a = (NEAR_M - depth_a) / ahead
            right_a, depth_a = right_a + way_a * across, NEAR_M
        elif depth_b < NEAR_M:
            way_b = (NEAR_M - depth_a) / ahead
            right_b, depth_b = right_a + way_b * across, NEAR_M
        u_a, u_b = lens[2] + lens[0] * right_a / depth_a, lens[2] + lens[0] * right_b / depth_b
        if max(u_a, u_b) <= -0.5 or min(u_a, u_b) >= width - 0.5 or u_a == u_b:
            continue
        row = seen[n]
        if u_a < u_b:
            row[0], row[1], row[2], row[3] = u_a, u_b, 1.0 / depth_a, 1.0 / depth_b
            row[4], row[5], row[6] = way_a / depth_a, way_b / depth_b, 1.0
        else:
            row[0], row[1], row[2], row[3] = u_b, u_a, 1.0 / depth_b, 1.0 / depth_a
            row[4], row[5], row[6] = way_b / depth_b, way_a / depth_a, 0.0
        row[7], row[8] = across, ahead
        which[n] = i
        n += 1
        for u in (u_a, u_b):
            if -0.5 < u < width - 0.5:
                borders[b] = u
                b += 1
    return seen[:n].copy(), which[:n].copy(), np.sort(borders[:b])


@compiled()
def _meet(
    seen: Array,
    which: Integers,
    kinds: Integers,
    u: float,
    right: float,
    depths: Array,
    keys: Array,
    order: Integers,
) -> int:
    """Sort surfaces in column `u` into `order`, near to far; fill `depths`; return their number."""
    met = 0
    for i in range(len(seen)):
        if not seen[i, 0] <= u < seen[i, 1]:
            continue
        share = (u - seen[i, 0]) / (seen[i, 1] - seen[i, 0])
        depth = 1.0 / (seen[i, 2] + share * (seen[i, 3] - seen[i, 2]))
        depths[i] = depth
        keys[i] = depth
        if kinds[which[i], 0] == PICTURE:
            facing = max(0.2, abs(seen[i, 8] * right - seen[i, 7]))
            keys[i] += _BEFORE_M / facing * (1.0 if seen[i, 6] == 0.0 else -1.0)
        at = met
        while at > 0 and keys[order[at - 1]] > keys[i]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        met += 1
    return met


@compiled()
def _through(
    order: Integers,
    met: int,
    at: int,
    depths: Array,
    kinds: Integers,
    which: Integers,
    solid: int,
) -> tuple[bool, float, float]:
    """Return whether the ray enters the solid there, and the depths between which it is inside.

    The last is negative if the ray leaves the solid there, unless it started inside.
    """
    before = after = 0
    depth = depths[order[at]]
    next_depth = depth
    for k in range(met):
        if kinds[which[order[k]], 2] == solid:
            if k < at:
                before += 1
            elif k > at:
                after += 1
                if after == 1:
                    next_depth = depths[order[k]]
    began_inside = (before + after + 1) % 2
    if (before + began_inside) % 2 == 0:
        return True, depth, next_depth
    return False, NEAR_M, (depth if before == 0 else -1.0)


@compiled(
    "void(float64[:, ::1], int64[::1], float64[::1], float64[:, ::1], float64[:, ::1],"
    " float64[::1], int64[:, ::1], float32[::1], int64[::1], int64[:, ::1], float32[::1],"
    " int64[::1], float64[::1], float64[::1], float64, float64, float32[:, ::1])"
)
def paint(
    seen: Array,
    which: Integers,
    borders: Array,
    extents: Array,
    scales: Array,
    brightness: Array,
    kinds: Integers,
    sums: Float32,
    begins: Integers,
    shapes: Integers,
    levels: Float32,
    level_begins: Integers,
    camera: Array,
    lens: Array,
    ceiling: float,
    spread: float,
    image: Float32,
) -> None:
    """Paint columns: `image` (w, h) gets the gray levels of full light.

    The first three arguments are results of `project`, then follow those of `VisibleSurfaces` and
    of `TextureAtlas`. `ceiling` is its height [m]; the light varies by the share `spread` [1].
    """
    width, height = image.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    level = camera[2]
    count = len(seen)
    depths, keys = np.empty(count), np.empty(count)
    order = np.empty(count, np.int64)
    value, left = np.empty(height), np.empty(height)
    # Per row: depth of a plane 1 m below or above the camera, and how coarse its texels are.
    unit, coarse = np.empty(height), np.empty(height)
    for r in range(height):
        unit[r] = fy / max(abs(r - cy), 1e-3)
        coarse[r] = 1.5 * math.log2(unit[r]) + math.log2(TEXELS_PER_M / fy)
    longest = PATTERN_TEXELS
    for i in range(len(shapes)):
        longest = max(longest, shapes[i, 1])
    for i in range(len(extents)):
        if kinds[i, 1] == PATTERN:
            longest = max(longest, int((extents[i, 1] - extents[i, 0]) * scales[i, 1]) + 1)
    strip = np.empty(longest + 2)
    image[:] = 0.0
    for k in range(len(borders) - 1):
        begin, end = borders[k], borders[k + 1]
        if end - begin < 1e-9:
            continue
        u = 0.5 * (begin + end)
        column = min(width - 1, max(0, math.floor(u + 0.5)))
        right = (u - cx) / fx
        met = _meet(seen, which, kinds, u, right, depths, keys, order)
        value[:] = 0.0
        left[:] = 1.0
        for at in range(met):
            i = order[at]
            surface = which[i]
            kind, solid = kinds[surface, 0], kinds[surface, 2]
            depth = depths[i]
            x = camera[0] + depth * (camera[3] + right * camera[4])
            y = camera[1] + depth * (camera[4] - right * camera[3])
            light = light_at(x, y, spread)
            bottom, top = extents[surface, 0], extents[surface, 1]
            first = cy + fy * (level - top) / depth
            last = cy + fy * (level - bottom) / depth
            if kind == GLASS:
                flat(value, left, first, last, _GLASS_TINT, _REFLECTION * light)
                continue
            if kind == PICTURE and seen[i, 6] == 0.0:
                flat(value, left, first, last, 1.0, _BACK * light)
                continue
            enters, begins_at, ends_at = True, depth, -1.0
            if solid > 0:
                enters, begins_at, ends_at = _through(order, met, at, depths, kinds, which, solid)
            if enters:
                side(
                    seen, i, begin, end, depth, first, last, top - level, surface, scales,
                    brightness[surface] * light, kinds, sums, begins, shapes, lens, strip,
                    value, left,
                )  # fmt: skip
            if solid > 0 and top < level and ends_at > begins_at:
                # One pixel beyond the edge of the side, which covers a part of it.
                plane(
                    value, left, cy + fy * (level - top) / ends_at,
                    cy + fy * (level - top) / begins_at + 1.0, level - top,
                    _TOP * brightness[surface], 1.0, spread, right, camera, unit, coarse, levels,
                    level_begins,
                )  # fmt: skip
            if solid == 0 and kind != PICTURE and bottom <= 0.0 and top >= ceiling:
                break
        plane(
            value, left, cy, height, level, _FLOOR, 1.0, spread, right, camera, unit, coarse,
            levels, level_begins,
        )  # fmt: skip
        plane(
            value, left, -1.0, cy, ceiling - level, _CEILING, 0.3, spread, right, camera, unit,
            coarse, levels, level_begins,
        )  # fmt: skip
        share = end - begin
        out = image[column]
        for r in range(height):
            out[r] += np.float32(share * value[r])
