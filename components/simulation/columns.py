"""An image column by column: what stands upright, and the planes of floor, tops and ceiling.

The camera is level, so each column of its image is one upright plane of the world: what it meets is
sorted by depth and painted from front to back. Pixels are means over their areas: of textures by
differences of sums, and at edges by slices of columns.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.atlas import PATTERN
from cairn.components.simulation.spans import TEXELS_PER_M, flat, light_at, plane, side
from cairn.components.simulation.surfaces import GLASS, PICTURE
from cairn.components.simulation.textures import PATTERN_TEXELS
from cairn.planar.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Float32 = NDArray[np.float32]

# Nothing nearer is seen [m].
NEAR_M = 0.05
# Pictures lie so far before what they hang on, and their backs behind it [m].
_BEFORE_M = 0.02
_FLOOR, _CEILING, _TOP, _BACK, _REFLECTION = 105.0, 200.0, 1.15, 90.0, 14.0
_GLASS_TINT = 0.1


@compiled(
    "Tuple((float64[:, ::1], int64[::1], float64[::1]))"
    "(float64[:, ::1], float64[::1], float64[::1], int64)"
)
def project(ends: Array, camera: Array, lens: Array, width: int) -> tuple[Array, Integers, Array]:
    """Which surfaces a camera sees, and where.

    `ends` as those of `Surfaces`; `camera` is x, y, height [m], cosine and sine of its heading;
    `lens` fx, fy, cx, cy [px]. The first result has for each surface seen the columns of its left
    and right end [px], 1 / depth [1/m] there, the way along it / depth there, 1 if its first end is
    on the left, else 0, and its direction across and ahead (unit length). The second has their
    indices; the third all borders of slices: those of pixels and of surfaces, in order.
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
    """What is met in a column `u`, in `order` from near to far; how many, and their `depths`."""
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
    """Whether the ray enters the solid there, and the depths between which it then is within it.

    The last is negative if it leaves the solid there, unless it has begun within it.
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
    """Paint columns: `image` (w, h) becomes gray levels in full light.

    The first three are results of `project`; the next those of `Surfaces`, then those of `Atlas`.
    The ceiling is at that height [m]; light varies from place to place by `spread` [1].
    """
    width, height = image.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    level = camera[2]
    count = len(seen)
    depths, keys = np.empty(count), np.empty(count)
    order = np.empty(count, np.int64)
    value, left = np.empty(height), np.empty(height)
    # Of each row: depth of a plane 1 m below or above the camera, and how coarse its texels are.
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
                # Down to a pixel behind the edge of the side, which covers part of it.
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
