"""Robots that share landmarks and cells: equal maps, how soon, how many bytes, at what cost."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from cairn.bus.codec import Codec
from cairn.components.map_builder.cell_messages import decision_message
from cairn.components.map_builder.component import MapBuilder
from cairn.components.map_builder.grid_keeper import GridKeeper
from cairn.components.map_builder.other_robots import OtherRobots
from cairn.components.map_builder.record_exchange import contributor_messages
from cairn.planar.grid import FREE, OCCUPIED, Frame, Grid
from cairn.planar.map_file import write_map
from cairn.planar.scans import Rays
from cairn.schemas.cairn_msgs import SharedCells
from cairn.testing.lockstep import ComponentHarness, Lockstep
from cairn_lab.benchmarks.result import Metric
from tests.components.localizer.room import ROOM, room, scanned
from tests.components.map_builder import test_grid_sharing, test_landmark_sharing
from tests.navigation.test_fleet import Repair, repair_maps_of_five_robots

HISTORIES = 10_000
_CRATES = 200  # moved in the hall
_FLEET = "/fleet/cells"
_BEAMS = 1081


def measure() -> list[Metric]:
    """Run random histories, a repair in the maps of five robots, a late robot, and many scans."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "five").mkdir()
        repair = repair_maps_of_five_robots(Path(folder) / "five")
        return [
            _histories("landmarks", test_landmark_sharing.history),
            _histories("cells", test_grid_sharing.history),
            *_repairs(repair),
            *_late_robot(Path(folder)),
            _cost(Path(folder)),
        ]


def _histories(name: str, history: Callable[[int], None]) -> Metric:
    began, unequal = time.process_time(), 0
    for seed in range(HISTORIES):
        try:
            history(seed)
        except AssertionError as error:
            print(error)
            unequal += 1
    took_s = time.process_time() - began
    note = f"partitions, repeated and reordered messages; {took_s:.0f} s of processor time"
    called = f"{HISTORIES:,} histories of three robots, {name}: unequal maps"
    return Metric(called, unequal, "", 0, None, note)


def _repairs(repair: Repair) -> list[Metric]:
    found_s = repair.first_s - repair.moved_s
    removed_s = repair.first_grid_s - repair.moved_s
    sizes = _bytes_per_s(repair.sent.messages)
    return [
        Metric("object moved: registered by the robot in front of it after", found_s, "s"),
        Metric(
            "repaired in the maps of all five robots", repair.all_s - repair.first_s, "s later", 5
        ),
        Metric("box removed: no longer in the grid map of the first robot after", removed_s, "s"),
        Metric(
            "in the grid maps of all five robots", repair.all_grids_s - repair.first_grid_s,
            "s later", 5,
        ),
        Metric("cells: most bytes of one robot in a second", max(sizes), "bytes/s", 10_000),
        Metric("cells: bytes of one robot in a second, mean", float(np.mean(sizes)), "bytes/s"),
    ]  # fmt: skip


def _bytes_per_s(messages: Iterable[SharedCells]) -> list[int]:
    """Return the bytes of each robot in each second in which it has sent any."""
    codec, sizes = Codec(), Counter[tuple[str, int]]()
    for one in messages:
        sizes[one.robot, one.header.stamp.sec] += len(codec.encode(one))
    return list(sizes.values())


def _late_robot(folder: Path) -> list[Metric]:
    """Let a robot join that has missed the moves of many crates in a hall of 50 m x 50 m."""
    hall = np.full((1000, 1000), FREE, np.int8)
    chance = np.random.default_rng(0)
    corners = chance.integers(0, 980, (_CRATES, 2, 2))
    for row, column in corners[:, 0]:
        hall[row : row + 12, column : column + 12] = OCCUPIED
    file = folder / "hall.yaml"
    write_map(file, Grid(hall, Frame(0.05)))
    copy = folder / "robot_1.yaml"
    keeper = GridKeeper(file, copy, 10**18, 8.0, 60.0, "robot_1")
    for k, ((row, column), (to_row, to_column)) in enumerate(corners):
        for at, value in (((row, column), FREE), ((to_row, to_column), OCCUPIED)):
            keeper.occupancy.cells[at[0] : at[0] + 12, at[1] : at[1] + 12] = value
        assert keeper.sharing is not None
        keeper.sharing.contribute(keeper.occupancy.cells, (0, 0, 1000, 1000), 10**18 + k * 10**9)
    keeper._changed = True
    keeper.save(10**18 + _CRATES * 10**9)
    decisions = len(list(keeper.sharing.record)) if keeper.sharing is not None else 0

    world = Lockstep(1e9 + 1000.0)
    robots = [
        ComponentHarness(
            MapBuilder,
            {
                "grid_file": str(file),
                "grid_copy": str(folder / f"{name}.yaml"),
                "share": True,
            },
            beside=world,
            robot=name,
            topics={"shared_cells": _FLEET, "others_cells": _FLEET},
        )
        for name in ("robot_1", "robot_2")
    ]
    sent = world.read(_FLEET, SharedCells)
    began = world.now

    def equal() -> bool:
        grids = [one.component._grid for one in robots]
        first, second = (one.occupancy.cells for one in grids if one is not None)
        return np.array_equal(first, second)

    while not equal():
        world.run_for(1.0)
    note = f"{_CRATES} crates moved in a hall of 50 m x 50 m: {decisions} decisions"
    size = (copy.with_suffix(".origin.json")).stat().st_size
    return [
        Metric("record of the working copy", size / 1000, "kB", note=note),
        Metric("a robot that was away has received it after", world.now - began, "s"),
        Metric(
            "most bytes of one robot in a second meanwhile",
            max(_bytes_per_s(sent.messages)),
            "bytes/s",
            12_500,
        ),
    ]


def _cost(folder: Path) -> Metric:
    """Integrate scans with and without sharing, alternately; an obstacle comes and goes."""
    file = folder / "room.yaml"
    write_map(file, room())
    scans = [_scans(with_box) for with_box in (False, True)]
    keepers = {
        name: GridKeeper(file, None, 10**18, 8.0, 60.0, name or None) for name in ("", "robot_1")
    }
    others, codec = OtherRobots(), Codec()
    took_s = dict.fromkeys(keepers, 0.0)
    for k in range(1000):
        rays = scans[k // 100 % 2][k % 10]
        now_s = 1e9 + 0.2 * k
        for name, keeper in keepers.items():
            began = time.thread_time()
            seen = rays
            if keeper.sharing is not None:
                for robot in range(4):
                    others.note(f"robot_{robot}", 2.0 + robot, 3.0, 0.22, round(now_s * 1e9))
                seen = others.out_of(rays, (2.0, 2.0, 0.0), round(now_s * 1e9))
            keeper.integrate(now_s, (2.0, 2.0, 0.0), seen)
            if keeper.sharing is not None and k % 3 == 0:  # a little more often than twice a second
                keeper.contribute()
                own = keeper.sharing.take_decisions(16)
                if own or k % 6 == 0:
                    codec.encode(
                        SharedCells(
                            robot=name,
                            cells=keeper.sharing.changed_cells,
                            contributors=contributor_messages(keeper.sharing.record),
                            decisions=tuple(map(decision_message, own)),
                        )
                    )
            took_s[name] += time.thread_time() - began
    note = f"{_BEAMS} beams, four robots near; {took_s[''] * 1e3 / 1000:.2f} ms without sharing"
    return Metric(
        "a scan into the grid map, with sharing relative to without",
        took_s["robot_1"] / took_s[""], "", 1.5, None, note,
    )  # fmt: skip


def _scans(with_box: bool) -> list[Rays]:
    boxes = (*ROOM, (3.5, 1.7, 3.9, 2.3)) if with_box else ROOM
    random, scans = np.random.default_rng(0), []
    for _ in range(10):
        points = scanned(room(boxes), (2.0, 2.0, 0.0), random, beams=_BEAMS, reach=9.0)
        angles = np.arctan2(points[:, 1], points[:, 0])
        ranges = np.hypot(points[:, 0], points[:, 1])
        scans.append(Rays(np.zeros((len(points), 2)), angles, ranges, 10.0))
    return scans
