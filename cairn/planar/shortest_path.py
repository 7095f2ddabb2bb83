"""The cheapest way over a grid of prices: A* in sixteen directions over a queue of buckets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled

Prices = NDArray[np.uint8]
"""Prices of a grid's cells (rows + 2 MARGIN, columns + 2 MARGIN), its margin closed."""

Cell = tuple[int, int]
"""Row and column of a cell of the grid, without the margin."""

MARGIN = 2
"""Rows and columns of closed cells around a grid of prices, so that no step leaves it."""
LEAST, DEAREST, CLOSED = 16, 253, 254
"""Price of a cell that costs its length alone, the highest price, and prices of no way from."""

# Lengths of a step straight on, aslant, and of a knight's move, times 12: 0.07 % and 0.6 % off.
_STRAIGHT, _ASLANT, _KNIGHT = 12, 17, 27
# The sixteen steps, rows and columns, in the order in which `_price_steps` prices them: in each
# quadrant straight on, aslant, and the knight's moves of two columns and of two rows.
_STEPS = np.array(
    [
        (0, 1), (1, 1), (1, 2), (2, 1),
        (-1, 0), (-1, 1), (-1, 2), (-2, 1),
        (1, 0), (1, -1), (1, -2), (2, -1),
        (0, -1), (-1, -1), (-1, -2), (-2, -1),
    ],
    np.int64,
)  # fmt: skip
# Cost over which a bucket reaches, as a power of two: a sixth of the shortest step, 384, so that
# few cells are entered again; and more buckets than the dearest step goes ahead,
# (27 * 4 * 253 / 2 + 864) / 2**6 = 227.
_BUCKET, _BUCKETS = 6, 256
_FIRST = 1 << _BUCKET
_DEAREST_STEP = 2**14
_EXHAUSTED, _FOUND, _OVERFLOW, _CROWDED = 0, 1, 2, 3
_TOP = 2**32 - 2 * _DEAREST_STEP


def priced(rows: int, columns: int) -> Prices:
    """A grid of prices of that size, all of it free, its margin closed."""
    prices = np.full((rows + 2 * MARGIN, columns + 2 * MARGIN), 255, np.uint8)
    prices[MARGIN:-MARGIN, MARGIN:-MARGIN] = LEAST
    return prices


@dataclass(frozen=True)
class Way:
    """What came of a search: the cells to pass, or where one can get.

    `cells` (n, 2) are rows and columns from start to goal, None if there is no way; consecutive
    ones are a step or a knight's move apart. `nearest` is the cell reached that is nearest to the
    goal; without a way all that can be reached was.
    """

    cells: NDArray[np.int64] | None
    nearest: Cell


class PathSearch:
    """Finds ways over grids of one size; keeps the memory that it works in.

    What a search reached carries numbers above those of all searches before, so that the memory
    need not be cleared between them.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        # Filled, so that the memory is there before the first search and not touched first by it.
        self._reached = np.full(int(np.prod(shape)), 0, np.uint32)
        self._base = _FIRST
        self._room = _room(1024 + self._reached.size // 8)

    def way(self, prices: Prices, start: Cell, goal: Cell) -> Way:
        """The cheapest way between two cells of the grid; the start must not be closed.

        A step costs its length times the mean price of the cells it touches; it touches no closed
        cell. The cost is within 2.8 % of that of the cheapest way in any directions, but for the
        half cells that a way over centers keeps off corners.
        """
        if prices.shape != self.shape:
            raise ValueError(f"prices of shape {prices.shape}, and room for {self.shape}")
        stride = prices.shape[1]
        flat = prices.reshape(-1)
        first, last = (
            int(row + MARGIN) * stride + column + MARGIN for row, column in (start, goal)
        )
        outcome, nearest, top = self._search(flat, stride, first, last)
        base, self._base = self._base, _after(top)
        closest = (nearest // stride - MARGIN, nearest % stride - MARGIN)
        if outcome != _FOUND:
            return Way(None, closest)
        return Way(_trace(flat, stride, self._reached, base, first, last), closest)

    def _search(self, flat: Prices, stride: int, first: int, last: int) -> tuple[int, int, int]:
        while True:
            outcome, nearest, top = _search(
                flat, stride, self._reached, self._base, first, last, *self._room
            )
            if outcome == _CROWDED:
                self._room = _room(2 * self._room[0].size)
                self._base = _after(int(top))
            elif outcome == _OVERFLOW and self._base > _FIRST:
                self._reached[:] = 0
                self._base = _FIRST
            else:
                return outcome, int(nearest), int(top)


def _after(top: int) -> int:
    """Where numbers begin anew: at a bucket's edge, so that equal searches go alike."""
    return ((top >> _BUCKET) + 1) << _BUCKET


def _room(size: int) -> tuple[NDArray[np.int32], NDArray[np.uint32], NDArray[np.int32]]:
    return np.full(size, 0, np.int32), np.full(size, 0, np.uint32), np.full(size, 0, np.int32)


@compiled()
def _ahead(rows: int, columns: int) -> int:
    """Least cost of a way over that many rows and columns in the sixteen directions."""
    a, b = abs(rows), abs(columns)
    if a < b:
        a, b = b, a
    if 2 * b <= a:
        return b * (_KNIGHT * 32) + (a - 2 * b) * (_STRAIGHT * 32)
    return (a - b) * (_KNIGHT * 32) + (2 * b - a) * (_ASLANT * 32)


@compiled()
def _price_steps(prices: Prices, stride: int, cell: np.int64, costs: NDArray[np.int64]) -> None:
    """What each of the `_STEPS` from a cell costs; 0 for one that is closed."""
    here = np.int64(prices[np.uintp(cell)])
    for side in range(2):
        x = 1 - 2 * side
        right = np.int64(prices[np.uintp(cell + x)])
        for end in range(2):
            y = (1 - 2 * end) * stride
            down = np.int64(prices[np.uintp(cell + y)])
            k = 8 * side + 4 * end
            straight = right if side == end else down
            costs[np.uintp(k)] = _STRAIGHT * (here + straight) if straight < CLOSED else 0
            costs[np.uintp(k + 1)] = costs[np.uintp(k + 2)] = costs[np.uintp(k + 3)] = 0
            aslant = np.int64(prices[np.uintp(cell + y + x)])
            if aslant >= CLOSED:
                continue
            if right < CLOSED:
                far = np.int64(prices[np.uintp(cell + y + 2 * x)])
                if far < CLOSED:
                    costs[np.uintp(k + 2)] = (_KNIGHT * (here + right + aslant + far)) >> 1
                if down < CLOSED:
                    costs[np.uintp(k + 1)] = _ASLANT * (here + aslant)
            if down < CLOSED:
                far = np.int64(prices[np.uintp(cell + 2 * y + x)])
                if far < CLOSED:
                    costs[np.uintp(k + 3)] = (_KNIGHT * (here + down + aslant + far)) >> 1


@compiled(
    "Tuple((int64, int64, int64))(uint8[::1], int64, uint32[::1], int64, int64, int64,"
    " int32[::1], uint32[::1], int32[::1])"
)
def _search(
    prices: Prices,
    stride: int,
    reached: NDArray[np.uint32],
    base: int,
    start: int,
    goal: int,
    cells: NDArray[np.int32],
    totals: NDArray[np.uint32],
    nexts: NDArray[np.int32],
) -> tuple[int, np.int64, np.int64]:
    """Fill `reached` with base + cost from the start; outcome, cell nearest the goal, top cost.

    `cells`, `totals` and `nexts` are the room for what waits in the buckets. Unsigned indices
    (`uintp`) spare the check for those that count from the end: 15 % of the time.
    """
    heads = np.full(_BUCKETS, -1, np.int32)
    costs = np.empty(len(_STEPS), np.int64)
    moves = _STEPS[:, 0] * stride + _STEPS[:, 1]
    width = np.uint32(stride)
    goal_row, goal_column = goal // stride, goal % stride
    nearest, least = np.int64(start), np.int64(2**62)
    top = np.int64(base)
    free, used, waiting = np.int64(-1), np.int64(1), np.int64(1)
    ahead = _ahead(goal_row - start // stride, goal_column - start % stride)
    cursor = (base + ahead) >> _BUCKET
    cells[0], totals[0], nexts[0] = start, base, -1
    heads[cursor & (_BUCKETS - 1)] = 0
    reached[start] = base
    while waiting > 0:
        while heads[cursor & (_BUCKETS - 1)] < 0:
            cursor += 1
        node = np.int64(heads[cursor & (_BUCKETS - 1)])
        heads[cursor & (_BUCKETS - 1)] = nexts[node]
        waiting -= 1
        cell = np.int64(cells[node])
        total = np.int64(totals[node])
        nexts[node] = free
        free = node
        if np.int64(reached[cell]) != total:
            continue
        top = max(top, total)
        if cell == goal:
            return _FOUND, cell, top + _DEAREST_STEP
        if total > _TOP:
            return _OVERFLOW, nearest, top
        if used + len(_STEPS) > cells.size:
            return _CROWDED, nearest, top + _DEAREST_STEP
        row = np.int64(np.uint32(cell) // width)
        r, c = goal_row - row, goal_column - (cell - row * stride)
        apart = r * r + c * c
        if apart < least:
            least, nearest = apart, cell
        _price_steps(prices, stride, cell, costs)
        for k in range(len(_STEPS)):
            if costs[np.uintp(k)] == 0:
                continue
            there = cell + moves[np.uintp(k)]
            cost = total + costs[np.uintp(k)]
            known = np.int64(reached[np.uintp(there)])
            if known >= base and known <= cost:
                continue
            reached[np.uintp(there)] = cost
            if free >= 0:
                node = free
                free = np.int64(nexts[np.uintp(node)])
            else:
                node = used
                used += 1
            ahead = cost + _ahead(r - _STEPS[np.uintp(k), 0], c - _STEPS[np.uintp(k), 1])
            bucket = (ahead >> _BUCKET) & (_BUCKETS - 1)
            cells[np.uintp(node)] = there
            totals[np.uintp(node)] = cost
            nexts[np.uintp(node)] = heads[np.uintp(bucket)]
            heads[np.uintp(bucket)] = node
            waiting += 1
    return _EXHAUSTED, nearest, top + _DEAREST_STEP


@compiled()
def _step(prices: Prices, stride: int, cell: int, y: int, x: int) -> np.int64:
    """Cost of the step from a cell by y rows and x columns; 0 if there is none such."""
    far, near = max(abs(y), abs(x)), min(abs(y), abs(x))
    there = np.int64(prices[cell + y * stride + x])
    if far == 0 or (far == 2 and near != 1) or there >= CLOSED:
        return np.int64(0)
    ends = np.int64(prices[cell]) + there
    if near == 0:
        return _STRAIGHT * ends
    if far == 1:
        if prices[cell + x] >= CLOSED or prices[cell + y * stride] >= CLOSED:
            return np.int64(0)
        return _ASLANT * ends
    half_x, half_y = x // 2 if abs(x) == 2 else 0, y // 2 if abs(y) == 2 else 0
    one = np.int64(prices[cell + half_y * stride + half_x])
    other = np.int64(prices[cell + (y - half_y) * stride + x - half_x])
    if one >= CLOSED or other >= CLOSED:
        return np.int64(0)
    return (_KNIGHT * (ends + one + other)) >> 1


@compiled("int64[:,::1](uint8[::1], int64, uint32[::1], int64, int64, int64)")
def _trace(
    prices: Prices, stride: int, reached: NDArray[np.uint32], base: int, start: int, goal: int
) -> NDArray[np.int64]:
    """The cells (n, 2) from start to goal, each reached the cheapest way from the one before."""
    chain = np.empty(1024, np.int64)
    count = 0
    cell = goal
    while True:
        if count == chain.size:
            longer = np.empty(2 * count, np.int64)
            longer[:count] = chain
            chain = longer
        chain[count] = cell
        count += 1
        if cell == start:
            break
        before, least = cell, np.int64(2**62)
        for y in range(-2, 3):
            for x in range(-2, 3):
                there = cell + y * stride + x
                cost = _step(prices, stride, cell, y, x)
                known = np.int64(reached[there])
                if cost > 0 and known >= base and known + cost < least:
                    before, least = there, known + cost
        cell = before
    way = np.empty((count, 2), np.int64)
    for i in range(count):
        way[count - 1 - i, 0] = chain[i] // stride - MARGIN
        way[count - 1 - i, 1] = chain[i] % stride - MARGIN
    return way
