"""Paths over cost grids are as cheap as by brute force, also in repeated searches."""

import heapq
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.planar.path_shape import cell_centers, pull_taut
from cairn.planar.shortest_path import (
    CLOSED,
    MARGIN,
    MAX_COST,
    MIN_COST,
    Cell,
    CellCosts,
    PathSearch,
    open_costs,
)
from tests.cairn.planar.any_angle import cost_along, shortest

MOVES = [
    (y, x) for y in range(-2, 3) for x in range(-2, 3) if {abs(y), abs(x)} in ({0, 1}, {1}, {1, 2})
]


def grid(prices: CellCosts) -> CellCosts:
    inner: CellCosts = prices[MARGIN:-MARGIN, MARGIN:-MARGIN]
    return inner


def touched(cell: Cell, y: int, x: int) -> list[Cell]:
    """The cells that a move touches: its ends, and the cells between."""
    row, column = cell
    ends = [(row, column), (row + y, column + x)]
    if abs(y) == abs(x) == 1:
        return [*ends, (row + y, column), (row, column + x)]
    if {abs(y), abs(x)} == {1, 2}:
        half_y, half_x = (y // 2 if abs(y) == 2 else 0), (x // 2 if abs(x) == 2 else 0)
        return [*ends, (row + half_y, column + half_x), (row + y - half_y, column + x - half_x)]
    return ends


def cheapest(prices: CellCosts, start: Cell, goal: Cell) -> dict[Cell, float]:
    """Dijkstra over the same moves, with true lengths; the cost of each cell that is reached."""
    best = {start: 0.0}
    queue = [(0.0, start)]
    while queue:
        cost, cell = heapq.heappop(queue)
        if cost > best[cell]:
            continue
        for y, x in MOVES:
            there = (cell[0] + y, cell[1] + x)
            cells = touched(cell, y, x)
            if any(prices[r + MARGIN, c + MARGIN] >= CLOSED for r, c in cells):
                continue
            paid = cells if {abs(y), abs(x)} == {1, 2} else cells[:2]
            mean = sum(float(prices[r + MARGIN, c + MARGIN]) for r, c in paid) / len(paid)
            total = cost + math.hypot(y, x) * mean / MIN_COST
            if total < best.get(there, math.inf):
                best[there] = total
                heapq.heappush(queue, (total, there))
    return best


def cost_of(prices: CellCosts, cells: NDArray[np.int64]) -> float:
    return sum(
        cheapest_step(prices, tuple(a), tuple(b))
        for a, b in zip(cells.tolist(), cells[1:].tolist(), strict=False)
    )


def cheapest_step(prices: CellCosts, a: Cell, b: Cell) -> float:
    cells = touched(a, b[0] - a[0], b[1] - a[1])
    assert all(prices[r + MARGIN, c + MARGIN] < CLOSED for r, c in cells)
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    paid = cells if length > 2 else cells[:2]
    mean = sum(float(prices[r + MARGIN, c + MARGIN]) for r, c in paid) / len(paid)
    return length * mean / MIN_COST


def random_prices(seed: int, rows: int, columns: int, share: float, dear: bool) -> CellCosts:
    rng = np.random.default_rng(seed)
    prices = open_costs(rows, columns)
    if dear:
        grid(prices)[:] = rng.integers(MIN_COST, MAX_COST + 1, (rows, columns))
    grid(prices)[rng.random((rows, columns)) < share] = 255
    grid(prices)[0, 0] = MIN_COST
    return prices


def serpentine(size: int, corridor: int, wall: int) -> CellCosts:
    prices = open_costs(size, size)
    for turn, row in enumerate(range(corridor, size - corridor, corridor + wall)):
        opening = slice(corridor, None) if turn % 2 else slice(None, size - corridor)
        grid(prices)[row : row + wall, opening] = 255
    return prices


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(1, 14),
    columns=st.integers(1, 14),
    share=st.floats(0, 0.6),
    dear=st.booleans(),
)
def test_path_costs_as_much_as_the_cheapest_by_brute_force(
    seed: int, rows: int, columns: int, share: float, dear: bool
) -> None:
    prices = random_prices(seed, rows, columns, share, dear)
    goal = (rows - 1, columns - 1)
    reference = cheapest(prices, (0, 0), goal)

    way = PathSearch(prices.shape).find(prices, (0, 0), goal)

    if goal in reference:
        assert way.cells is not None
        assert tuple(way.cells[0]) == (0, 0)
        assert tuple(way.cells[-1]) == goal
        # Lengths are counted in twelfths, and costs that differ by less than a sixth of a step are
        # expanded in any order.
        assert cost_of(prices, way.cells) <= 1.01 * reference[goal] + 0.2
    else:
        assert way.cells is None
        nearest = min(math.dist(cell, goal) for cell in reference)
        assert way.nearest in reference
        assert math.dist(way.nearest, goal) == pytest.approx(nearest)


@pytest.mark.parametrize("seed", range(12))
def test_taut_path_is_as_short_as_the_any_angle_optimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 26
    prices = open_costs(size, size)
    for _ in range(7):
        height, width = rng.integers(1, 9, 2)
        row, column = rng.integers(0, size, 2)
        grid(prices)[row : row + height, column : column + width] = 255
    grid(prices)[:2, :2] = grid(prices)[-2:, -2:] = MIN_COST
    optimum = shortest(grid(prices) >= CLOSED, (0, 0), (size - 1, size - 1))

    way = PathSearch(prices.shape).find(prices, (0, 0), (size - 1, size - 1))

    assert (way.cells is None) == math.isinf(optimum)
    if way.cells is not None:
        length = cost_along(prices, pull_taut(prices, cell_centers(way.cells)))
        assert 0.999 * optimum <= length <= 1.03 * optimum


@pytest.mark.parametrize("seed", range(4))
def test_lengths_to_all_cells_are_those_of_the_cheapest_paths(seed: int) -> None:
    prices = random_prices(seed, 14, 17, 0.35, dear=seed % 2 == 0)
    search = PathSearch(prices.shape)
    for start in ((0, 0), (0, 0), (13, 16)):
        grid(prices)[start] = MIN_COST
        reference = cheapest(prices, start, (0, 0))

        lengths = search.lengths(prices, start)

        for cell, length in np.ndenumerate(lengths):
            known = reference.get((cell[0], cell[1]), math.inf)
            assert length == pytest.approx(known, rel=0.01, abs=0.01)
        search.find(prices, start, (7, 7))


def test_path_through_a_serpentine_is_found() -> None:
    prices = serpentine(200, 5, 5)
    # 19 walls, past whose ends it goes: 190 across and 5 down from one to the next, 5 along each.
    length = math.hypot(192.5, 2.5) + 19 * 5 + 18 * math.hypot(190, 5) + math.hypot(2.5, 7.5)

    way = PathSearch(prices.shape).find(prices, (2, 2), (197, 197))

    assert way.cells is not None
    line = pull_taut(prices, cell_centers(way.cells))
    assert cost_along(prices, line) == pytest.approx(length, rel=0.005)


def test_corridor_of_one_cell_is_passable_and_a_diagonal_gap_is_not() -> None:
    prices = open_costs(9, 9)
    grid(prices)[4] = 255
    grid(prices)[4, 6] = MIN_COST
    search = PathSearch(prices.shape)
    assert search.find(prices, (0, 0), (8, 0)).cells is not None

    grid(prices)[5, 6] = grid(prices)[5, 5] = 255
    grid(prices)[5, 7] = MIN_COST

    assert search.find(prices, (0, 0), (8, 0)).cells is None


def test_consecutive_searches_are_independent() -> None:
    winding = serpentine(300, 2, 1)
    grid(winding)[grid(winding) < CLOSED] = MAX_COST  # so expensive that costs soon exceed 32 bits
    other = random_prices(5, 300, 300, 0.1, dear=False)
    search = PathSearch(winding.shape)
    first = search.find(winding, (0, 0), (299, 299)).cells
    assert first is not None
    free = search.find(other, (0, 0), (299, 299)).cells
    assert free is not None

    for _ in range(40):
        again = search.find(winding, (0, 0), (299, 299)).cells
        assert again is not None
        np.testing.assert_array_equal(again, first)
    elsewhere = search.find(other, (0, 0), (299, 299)).cells

    assert elsewhere is not None
    np.testing.assert_array_equal(elsewhere, free)


def test_queue_grows_when_it_is_full() -> None:
    comb = open_costs(300, 300)  # cheap teeth along which the search runs ahead of all the rest
    grid(comb)[:] = MAX_COST
    grid(comb)[::4] = grid(comb)[:, :2] = MIN_COST

    way = PathSearch(comb.shape).find(comb, (150, 0), (299, 299))

    assert way.cells is not None
    assert cost_of(comb, way.cells) == pytest.approx(146 + 297 + 3 * MAX_COST / MIN_COST, rel=0.05)


def test_grid_of_another_size_is_rejected() -> None:
    with pytest.raises(ValueError, match=r"\(14, 14\).*\(24, 24\)"):
        PathSearch((24, 24)).find(open_costs(10, 10), (0, 0), (9, 9))
    with pytest.raises(ValueError, match=r"\(14, 14\).*\(24, 24\)"):
        PathSearch((24, 24)).lengths(open_costs(10, 10), (0, 0))
