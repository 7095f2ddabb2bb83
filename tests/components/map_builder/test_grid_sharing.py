"""Tests of shared cells: merging, equal maps after any history, and what robots adopt."""

import math
import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.map_builder.cell_record import (
    CellRecord,
    Decision,
    Tiles,
    cells_in,
    check_decision,
    set_of,
)
from cairn.components.map_builder.grid_keeper import GridKeeper
from cairn.components.map_builder.grid_sharing import CellSharing
from cairn.components.map_builder.occupancy import Occupancy
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid
from cairn.planar.map_file import write_map
from cairn.planar.scans import Rays

S = 10**9
DAY_S = 86_400
ROBOTS = ("ada", "ben", "cleo")
SHAPE = (20, 40)  # six tiles, of which all but one are cut by the map's edges
TILES = Tiles(SHAPE)


@st.composite
def decisions(draw: st.DrawFn) -> Decision:
    # Few values, so that equal ranks and common cells occur.
    states = draw(st.lists(st.integers(0, 3), min_size=4, max_size=4).filter(any))
    free, occupied, unknown = (
        sum(1 << (17 * k) for k, state in enumerate(states) if state == wanted)
        for wanted in (1, 2, 3)
    )
    one = Decision(
        draw(st.sampled_from(ROBOTS)),
        draw(st.integers(0, 1)),
        draw(st.integers(1, 3)),
        free,
        occupied,
        unknown,
    )
    check_decision(one, TILES)
    return one


@pytest.mark.accuracy
@settings(max_examples=200, deadline=None)
@given(*(st.lists(decisions(), max_size=8) for _ in range(3)))
def test_merging_is_commutative_associative_and_idempotent(
    a: list[Decision], b: list[Decision], c: list[Decision]
) -> None:
    def merged(*parts: Sequence[Decision] | CellRecord) -> CellRecord:
        record = CellRecord()
        for part in parts:
            record.merge(list(part))
        return record

    assert merged(a, b) == merged(b, a)
    assert merged(merged(a, b), c) == merged(a, merged(b, c))
    assert merged(a, a) == merged(a)
    assert merged(a, merged(a, b)) == merged(a, b)
    assert merged(a, b, c).summaries() == merged(c, b, a).summaries()
    assert [*merged([*a, *b, *c])] == [*merged(c, a, b)]
    of_robots = [one for robot in ROBOTS for one in merged(a, b).of(robot)]
    assert merged(of_robots) == merged(a, b)


@settings(max_examples=100, deadline=None)
@given(st.lists(decisions(), max_size=8))
def test_latest_decision_about_each_cell_counts(given_: list[Decision]) -> None:
    record = CellRecord(given_)

    for tile in (0, 1):
        for k in range(4):
            bit = 1 << (17 * k)
            about = [one for one in given_ if one.tile == tile and one.cells & bit]
            kept = [one for one in record.about(tile) if one.cells & bit]
            latest = [max(one.rank for one in about)] if about else []
            assert [one.rank for one in kept] == latest


def middle() -> Grid[np.int8]:
    cells = np.full(SHAPE, FREE, np.int8)
    cells[8:12, 18:24] = OCCUPIED
    cells[:, 36:] = UNKNOWN
    return Grid(cells, Frame(0.05))


LOOK = np.linspace(-math.pi, math.pi, 60)


class _Robot:
    """A robot that judges cells at random, and scans that confirm others."""

    def __init__(self, name: str) -> None:
        self.occupancy = Occupancy(middle(), 8.0, 60.0)
        self.sharing = CellSharing(name, self.occupancy.cells)

    def look(self, chance: random.Random, now_s: float) -> list[Decision]:
        """Let rays pass cells, and end at some: what this changes and confirms depends on both."""
        pose = (chance.uniform(0.2, 1.6), chance.uniform(0.2, 0.8), 0.0)
        far = chance.choice((0.3, 0.8))
        rays = Rays(np.zeros((60, 2)), LOOK, np.full(60, far), 5.0)
        for k in range(chance.choice((1, 22))):
            self.occupancy.integrate(now_s + 0.5 * k, pose, rays)
        return self._contribute(now_s)

    def judge(self, chance: random.Random, now_s: float) -> list[Decision]:
        """Change a rectangle of cells, as scans or their undoing may."""
        top, left = chance.randrange(SHAPE[0]), chance.randrange(SHAPE[1])
        chosen = (
            slice(top, top + chance.randrange(1, 8)),
            slice(left, left + chance.randrange(1, 8)),
        )
        self.occupancy.cells[chosen] = chance.choice((FREE, OCCUPIED, UNKNOWN))
        return self._contribute(now_s)

    def receive(self, sent: Sequence[Decision]) -> list[Decision]:
        self.sharing.merge(sent, self.occupancy)
        return self._contribute(0.0)

    def _contribute(self, now_s: float) -> list[Decision]:
        self.sharing.contribute(self.occupancy.cells, (0, 0, *SHAPE), round(now_s * S))
        assert np.array_equal(self.sharing.cells, self.occupancy.cells)
        return self.sharing.take_decisions(1000)


def history(seed: int) -> None:
    """Let three robots change cells and exchange messages that are lost, repeated and reordered.

    Then each receives everything, in an order of its own, and what others answer to that.
    """
    chance = random.Random(seed)
    robots = [_Robot(name) for name in ROBOTS]
    errors_s = [chance.choice((0.0, 3.0, 3600.0)) for _ in robots]  # of the clocks
    sent: list[Decision] = []
    for step in range(1, chance.randrange(4, 12)):
        k = chance.randrange(3)
        now_s = step * chance.choice((1.0, 600.0)) + errors_s[k]
        act = chance.choice((robots[k].judge, robots[k].look))
        sent += act(chance, now_s)
        if sent and chance.random() < 0.5:  # a partition otherwise
            sent += chance.choice(robots).receive(chance.choices(sent, k=2))
    answers = sent
    for _ in range(4):
        answers = [
            one for robot in robots for one in robot.receive(chance.sample(answers, len(answers)))
        ]
        sent += answers
    assert not answers, f"history {seed}: robots go on to contradict each other"
    a, b, c = robots
    assert a.sharing.record == b.sharing.record == c.sharing.record == CellRecord(sent)
    assert a.sharing.record.summaries() == b.sharing.record.summaries()
    assert np.array_equal(a.occupancy.cells, b.occupancy.cells), f"history {seed}"
    assert np.array_equal(a.occupancy.cells, c.occupancy.cells), f"history {seed}"


@pytest.mark.accuracy
def test_robots_have_equal_maps_after_random_histories() -> None:
    for seed in range(200):  # `python -m cairn_lab.benchmarks.sharing` runs 10,000
        history(seed)


POST = (30, 60)


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "map.yaml"
    cells = np.full((60, 80), FREE, np.int8)
    cells[POST] = OCCUPIED
    write_map(path, Grid(cells, Frame(0.05)))
    return path


def keeper(map_file: Path, robot: str | None, now_s: float = 1e9, copy: str = "") -> GridKeeper:
    path = map_file.with_name(f"{copy or robot}.yaml")
    return GridKeeper(map_file, path, round(now_s * S), 8.0, 60.0, robot)


def pass_the_post(robot: GridKeeper, now_s: float, scans: int = 22) -> list[Decision]:
    """Let rays pass where the post is, for 4.4 s; return what the robot decides."""
    around = np.linspace(-math.pi, math.pi, 481, endpoint=False)
    rays = Rays(np.zeros((481, 2)), around, np.full(481, 1.4), 10.0)
    for k in range(scans):
        robot.integrate(now_s + 0.2 * k, (2.02, 1.52, 0.0), rays)
    return decided(robot)


def hit_the_post(robot: GridKeeper, now_s: float, seconds: float = 10.0) -> list[Decision]:
    rays = Rays(np.zeros((9, 2)), np.linspace(-0.01, 0.01, 9), np.full(9, 1.0), 10.0)
    for k in range(round(seconds / 0.2)):
        robot.integrate(now_s + 0.2 * k, (2.02, 1.52, 0.0), rays)
    return decided(robot)


def decided(robot: GridKeeper) -> list[Decision]:
    robot.contribute()
    assert robot.sharing is not None
    return robot.sharing.take_decisions(1000)


def everything(robot: GridKeeper) -> list[Decision]:
    assert robot.sharing is not None
    return list(robot.sharing.record)


def cells(robot: GridKeeper) -> NDArray[np.int8]:
    return robot.occupancy.cells


def test_what_one_robot_removes_is_removed_from_all_maps(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")

    sent = pass_the_post(ada, 1e9)
    (window,) = ben.merge(sent)

    assert cells(ben)[POST] == FREE
    assert window.values[POST[0] - window.row, POST[1] - window.column] == FREE
    assert np.array_equal(cells(ada), cells(ben))
    assert ben.merge(sent) == []  # repeated
    assert decided(ben) == []  # what a robot has learned from another is not its own


def test_old_decisions_do_not_bring_back_what_was_removed(map_file: Path) -> None:
    ada, ben, cleo = (keeper(map_file, name) for name in ROBOTS)
    first = pass_the_post(ada, 1e9)
    back = [*first, *hit_the_post(ada, 1e9 + 100.0)]
    ben.merge(back)
    assert cells(ben)[POST] == OCCUPIED
    gone = pass_the_post(ben, 1e9 + 200.0)

    cleo.merge(gone)
    cleo.merge(back)  # later
    ada.merge(gone)

    assert [cells(robot)[POST] for robot in (ada, ben, cleo)] == [FREE] * 3
    assert everything(ada) == everything(cleo)


def test_later_evidence_of_a_robot_that_was_away_wins(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")
    gone = pass_the_post(ada, 1e9)
    assert hit_the_post(ben, 1e9 + 2 * DAY_S, 1.0) == []  # it is as in its map

    assert ben.merge(gone) == []
    (window,) = ada.merge(decided(ben))

    assert (cells(ada)[POST], cells(ben)[POST]) == (OCCUPIED, OCCUPIED)
    assert everything(ada) == everything(ben)
    assert window.values[POST[0] - window.row, POST[1] - window.column] == OCCUPIED


def test_fresh_decisions_are_adopted_although_a_robot_has_seen_otherwise(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")
    hit_the_post(ben, 1e9 + 10.0, 1.0)

    ben.merge(pass_the_post(ada, 1e9))

    assert cells(ben)[POST] == FREE
    assert decided(ben) == []


def test_adopted_cells_need_as_many_contrary_scans_as_the_map(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")
    pass_the_post(ada, 1e9)
    ben.merge([*everything(ada), *hit_the_post(ada, 1e9 + 100.0)])

    assert pass_the_post(ben, 1e9 + 300.0, scans=19) == []
    assert cells(ben)[POST] == OCCUPIED
    assert pass_the_post(ben, 1e9 + 304.0, scans=3)
    assert cells(ben)[POST] == FREE


def test_restarted_robot_knows_what_others_have_decided(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")
    ben.merge(pass_the_post(ada, 1e9))
    ben.save(round((1e9 + 60.0) * S))

    again = keeper(map_file, "ben", 1e9 + 5 * DAY_S)
    new = keeper(map_file, "new")
    new.merge(everything(again))

    assert everything(again) == everything(ada)
    assert decided(again) == []
    assert cells(again)[POST] == FREE
    assert np.array_equal(cells(new), cells(ada))


def test_changes_made_while_not_sharing_are_shared_later(map_file: Path) -> None:
    ada = keeper(map_file, "ada")
    pass_the_post(ada, 1e9)
    ada.save(round((1e9 + 10.0) * S))
    alone = keeper(map_file, None, 1e9 + 20.0, copy="ada")
    wall = Rays(np.zeros((9, 2)), np.linspace(-0.01, 0.01, 9), np.full(9, 0.5), 10.0)
    for k in range(60):
        alone.integrate(1e9 + 100.0 + 0.2 * k, (2.02, 1.52, 0.0), wall)
    alone.save(round((1e9 + 200.0) * S))

    again, ben = keeper(map_file, "ada", 1e9 + 300.0), keeper(map_file, "ben")
    ben.merge(everything(again))

    assert (cells(ben) == OCCUPIED).any()
    assert cells(ben)[POST] == FREE  # as it was shared before
    assert np.array_equal(cells(again), cells(ben))
    newest = max(one.stamp_ns for one in everything(again))
    assert newest == round((1e9 + 200.0) * S)  # when the copy was saved


def test_lost_robot_takes_back_what_it_has_shared(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")
    ben.merge(pass_the_post(ada, 1e9))
    assert cells(ben)[POST] == FREE

    assert ada.undo(1e9 - 1.0, round((1e9 + 10.0) * S)) is not None
    ben.merge(decided(ada))

    assert (cells(ada)[POST], cells(ben)[POST]) == (OCCUPIED, OCCUPIED)
    assert np.array_equal(cells(ada), cells(ben))


def test_what_others_have_decided_since_is_not_undone(map_file: Path) -> None:
    ada, ben = keeper(map_file, "ada"), keeper(map_file, "ben")
    ben.merge(pass_the_post(ada, 1e9))
    ada.merge(hit_the_post(ben, 1e9 + 10.0))
    ada.merge(pass_the_post(ben, 1e9 + 30.0))

    assert ada.undo(1e9 - 1.0, round((1e9 + 40.0) * S)) is None

    assert cells(ada)[POST] == FREE
    assert everything(ada) == everything(ben)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "Ada; DROP"}, "not the name of a robot"),
        ({"tile": -1}, "no tile -1"),
        ({"tile": TILES.count}, "no tile 6"),
        ({"stamp_ns": 0}, "time 0"),
        ({"stamp_ns": 2**63}, "time"),
        ({"free": 0}, "about no cell"),
        ({"occupied": 3}, "two states"),
        ({"unknown": 1}, "two states"),
        ({"tile": 5, "free": 1 << 255}, "outside the map"),
    ],
)
def test_decisions_that_no_robot_makes_are_invalid(change: dict[str, object], words: str) -> None:
    good = Decision("ada", 1, 1, free=1)
    check_decision(good, TILES)

    with pytest.raises(ValueError, match=words):
        check_decision(replace(good, **change), TILES)  # type: ignore[arg-type]


def test_sets_of_cells() -> None:
    some = np.random.default_rng(0).random((4, 8)) < 0.5

    members = set_of(some)

    assert np.array_equal(cells_in(members)[:4, :8], some)
    assert not cells_in(members)[4:].any()
    assert [TILES.window(tile) for tile in (0, 5)] == [
        (slice(0, 16), slice(0, 16)),
        (slice(16, 20), slice(32, 40)),
    ]
    assert TILES.at(np.array([3, 19, 16]), np.array([15, 39, 16])) == [0, 4, 5]
