"""Tests of the component: robots with the same grid map share what they find out about cells."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import LATCHED, CairnError, from_ns
from cairn.components.map_builder.component import MapBuilder
from cairn.components.map_builder.grid_keeper import grid_digest
from cairn.components.path_planner.component import PathPlanner
from cairn.planar.grid import FREE, OCCUPIED
from cairn.planar.map_file import read_map, write_map
from cairn.planar.messages import planar_poses, with_covariance
from cairn.schemas.cairn_msgs import (
    MOST_DECISIONS,
    CellDecision,
    RecordContributor,
    SharedCells,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, Plan
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness, Lockstep
from tests.components.localizer.room import ROOM, Box, room
from tests.components.map_builder.test_component_grid import watch
from tests.components.path_planner.rooms import follow, pose_at

FLEET = "/fleet/cells"
WALL: tuple[Box, ...] = ((4.4, 0.0, 4.6, 1.4), (4.4, 2.6, 4.6, 7.0))
CRATE: Box = (4.3, 1.4, 4.7, 2.6)  # in the passage of the wall
CLOSED, OPEN = room((*WALL, CRATE)), room(WALL)
PASSAGE = slice(33, 47), slice(86, 94)  # its cells, without those beside the wall
PARKED: Box = (2.85, 1.85, 3.15, 2.15)  # a robot
BELOW = slice(36, 44), slice(56, 64)
Builder = ComponentHarness[MapBuilder]


@pytest.fixture
def grid_file(tmp_path: Path) -> Path:
    file = tmp_path / "map.yaml"
    write_map(file, CLOSED)
    return file


def builder(world: Lockstep, grid_file: Path, robot: str, **topics: str) -> Builder:
    parameters = {
        "grid_file": str(grid_file),
        "grid_copy": str(grid_file.with_name(f"{robot}.yaml")),
        "share": True,
    }
    both = {"shared_cells": FLEET, "others_cells": FLEET, **topics}
    return ComponentHarness(MapBuilder, parameters, beside=world, robot=robot, topics=both)


def cells(it: Builder) -> Any:
    grid = it.component._grid
    assert grid is not None
    return grid.occupancy.cells


def stand_at(it: Builder, x: float, y: float) -> None:
    """Publish where a robot stands."""
    header = Header(stamp=from_ns(it.now_ns), frame_id="map")
    pose = with_covariance((x, y, 0.0), np.diag([1e-4, 1e-4, 1e-4]))
    it.publish("localization", LocalizationEstimate(header=header, located=True, pose=pose))


def test_crate_removed_before_one_robot_opens_the_passage_for_all(grid_file: Path) -> None:
    world = Lockstep(1000.0)
    robots = [builder(world, grid_file, f"robot_{k}") for k in range(1, 6)]
    planner = ComponentHarness(PathPlanner, {}, beside=world, robot="robot_5")
    planner.publish("localization", pose_at((2.0, 5.0, 0.0), world.now))
    planner.publish("nav_command", follow((7.0, 5.0, 0.0), command_id=1))
    (closed,) = planner.take("plan")
    assert closed.outcome == Plan.UNREACHABLE
    watch(robots[0], CLOSED, 2.0)

    watch(robots[0], OPEN, 5.0)  # five seconds after it was removed

    assert all((cells(robot)[PASSAGE] == FREE).all() for robot in robots)
    world.run_for(0.5)
    assert all(np.array_equal(cells(robots[0]), cells(robot)) for robot in robots)
    planner.publish("localization", pose_at((2.0, 5.0, 0.0), world.now))
    planner.publish("nav_command", follow((7.0, 5.0, 0.0), command_id=2))
    opened = planner.take("plan")[-1]
    assert opened.outcome == Plan.FOUND
    through = planar_poses(opened.poses)
    assert np.abs(through[:, 0] - 4.5).min() < 0.1  # it leads to the other side of the wall


def test_robot_that_was_off_for_days_gets_it_from_one_that_was_not_there(grid_file: Path) -> None:
    world = Lockstep(1000.0)
    first, second = (builder(world, grid_file, f"robot_{k}") for k in (1, 2))
    watch(first, OPEN, 7.0)
    for robot in (first, second):
        robot.request("deactivate")
        robot.request("shutdown")

    later = Lockstep(1000.0 + 5 * 86_400)
    again = builder(later, grid_file, "robot_2")
    third = builder(later, grid_file, "robot_3")
    later.run_for(5.0)

    assert (cells(third)[PASSAGE] == FREE).all()
    assert np.array_equal(cells(third), cells(again))
    newest = [robot.take("shared_cells")[-1] for robot in (again, third)]
    assert newest[0].contributors == newest[1].contributors != ()
    assert [one.robot for one in newest[0].contributors] == ["robot_1"]
    later.run_for(10.0)
    sent = [one for robot in (again, third) for one in robot.take("shared_cells")]
    assert not any(one.decisions for one in sent)  # all have everything


def test_lost_messages_are_sent_again_within_the_limit(grid_file: Path) -> None:
    world = Lockstep(1000.0)
    first, second = (builder(world, grid_file, f"robot_{k}") for k in (1, 2))
    second.request("deactivate")  # it receives nothing now
    keeper = first.component._grid
    assert keeper is not None
    whole = cells(first)
    for row in range(0, 140, 16):  # 108 tiles, in ten decisions each
        for k in range(10):
            whole[row : row + 5, k::20] = OCCUPIED if (k + row // 16) % 2 else FREE
            keeper._undecided = (0, 0, *whole.shape)
            keeper.contribute()
    world.run_for(30.0)
    first.take("shared_cells")

    second.request("activate")
    world.run_for(60.0)

    assert np.array_equal(cells(first), cells(second))
    sizes = [len(one.decisions) for one in first.take("shared_cells")]
    assert sum(sizes) > MOST_DECISIONS
    assert max(sizes) == MOST_DECISIONS


def test_robots_that_stand_in_scans_are_kept_out_of_the_map(grid_file: Path) -> None:
    world = Lockstep(1000.0)
    first, second = (builder(world, grid_file, f"robot_{k}") for k in (1, 2))
    scene = room((*WALL, CRATE, PARKED))
    for _ in range(12):
        stand_at(second, 3.0, 2.0)
        watch(first, scene, 1.0)
    assert np.array_equal(cells(first), CLOSED.values)

    watch(first, scene, 12.0)  # it publishes no more where it is

    assert (cells(first)[BELOW] == OCCUPIED).any()
    assert np.array_equal(cells(first), cells(second))


def test_robot_frees_the_place_where_it_stands_itself(grid_file: Path) -> None:
    world = Lockstep(1000.0)
    first, second = (builder(world, grid_file, f"robot_{k}") for k in (1, 2))
    second.request("deactivate")
    watch(first, room((*WALL, CRATE, PARKED)), 12.0)
    assert (cells(first)[BELOW] == OCCUPIED).any()

    second.request("activate")
    for _ in range(8):
        stand_at(second, 3.0, 2.0)
        world.run_for(0.5)

    assert (cells(second)[BELOW] == FREE).all()
    assert np.array_equal(cells(first), cells(second))


def test_hostile_decisions_are_rejected_and_counted(
    grid_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = Lockstep(1000.0)
    it = builder(world, grid_file, "robot_1")
    everywhere = np.full(32, 255, np.uint8)
    good = CellDecision(robot="robot_9", tile=0, stamp=1, free=everywhere)
    hostile = (
        replace(good, robot="../etc"),
        replace(good, robot="robot_1 "),
        replace(good, tile=2**32 - 1),
        replace(good, stamp=0),
        replace(good, stamp=2**63),
        replace(good, stamp=10**18),  # years ahead
        replace(good, free=np.zeros(32, np.uint8)),
        replace(good, occupied=everywhere),
        replace(good, tile=11),  # at the edge, which cuts it
    )
    digest = grid_digest(read_map(grid_file))
    message = SharedCells(robot="robot_9", map=digest, x=1e300, y=1.0, decisions=hostile)

    world.publish(FLEET, message, qos=LATCHED)
    world.run_for(2.0)

    assert it.take("map_updates") == []
    assert it.take("shared_cells")[-1].rejected == len(hostile)
    assert "rejected contribution from 'robot_9', of 'robot_9' about tile 11: it is" in caplog.text
    world.publish(FLEET, replace(message, decisions=(good,)))
    world.run_for(2.0)
    assert len(it.take("map_updates")) == 1
    more = tuple(
        replace(good, robot=f"robot_{k}", tile=12 * (k // 10) + k % 10) for k in range(10, 74)
    )
    world.publish(FLEET, replace(message, decisions=more))
    world.run_for(2.0)
    newest = it.take("shared_cells")[-1]
    assert (len(newest.contributors), newest.rejected) == (63, len(hostile) + 2)


def test_robots_with_another_map_share_nothing(
    grid_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = Lockstep(1000.0)
    other = grid_file.with_name("other.yaml")
    write_map(other, room(ROOM))
    first, second = builder(world, grid_file, "robot_1"), builder(world, other, "robot_2")

    watch(first, OPEN, 7.0)

    assert np.array_equal(cells(second), room(ROOM).values)
    assert "robot 'robot_1' has another map" in caplog.text
    assert "give both the same grid_file" in caplog.text


def test_robot_with_a_name_that_another_one_has_is_warned(
    grid_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = Lockstep(1000.0)
    builder(world, grid_file, "robot_1")
    contributors = (RecordContributor(robot="robot_1", newest=7, count=1),)
    message = SharedCells(robot="robot_1", map="a" * 64, contributors=contributors)

    world.publish(FLEET, message, qos=LATCHED)

    assert "another robot has the name robot_1" in caplog.text


def test_ports_on_different_topics_are_an_error(grid_file: Path) -> None:
    with pytest.raises(CairnError, match=r"shared_cells .* give both the same one, such as /fleet"):
        builder(Lockstep(1000.0), grid_file, "robot_1", shared_cells="shared_cells")


def test_sharing_without_a_working_copy_is_an_error(grid_file: Path) -> None:
    with pytest.raises(CairnError, match="share requires grid_file and grid_copy"):
        ComponentHarness(MapBuilder, {"grid_file": str(grid_file), "share": True})
