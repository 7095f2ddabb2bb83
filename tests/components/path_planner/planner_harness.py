"""A harness around the path planner: a test publishes its inputs and reads its plans."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cairn.components.path_planner.component import PathPlanner
from cairn.planar.grid import OccupancyCells
from cairn.planar.messages import planar_poses
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import Plan
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.testing.lockstep import ComponentHarness
from tests.components.path_planner.rooms import (
    RESOLUTION,
    Box,
    as_map,
    clearance,
    odom_at,
    pose_at,
    room,
    scan_of,
    wall_with_door,
)

BEGIN = 100.0
HERE, THERE = (1.0, 1.0, 0.0), (8.0, 6.0, 1.0)
DOOR = wall_with_door(0.9)


def start_planner(
    grid: OccupancyCells | None, pose: Pose | None = HERE, **parameters: Any
) -> ComponentHarness[PathPlanner]:
    """Return an active path planner that has received a map and the robot's pose, if given."""
    planner = ComponentHarness(PathPlanner, parameters, start_s=BEGIN)
    if grid is not None:
        planner.publish("map", as_map(grid))
    if pose is not None:
        planner.publish("localization", pose_at(pose, BEGIN))
    return planner


def scan_standing(
    planner: ComponentHarness[PathPlanner],
    grid: OccupancyCells,
    duration: float,
    pose: Pose = HERE,
    health: float = 1.0,
) -> None:
    """Let the robot stand for `duration` [s] and scan a room ten times per second."""
    for _ in range(round(duration * 10)):
        planner.run_for(0.1)
        planner.publish("odom", odom_at((0.0, 0.0, 0.0), planner.now))
        planner.publish("scan", scan_of(grid, pose, planner.now))
        planner.publish("localization", pose_at(pose, planner.now, health))


def map_update(box: Box, kind: int) -> OccupancyGridUpdate:
    """Return an update that sets all cells of a box to `kind`."""
    x, y, right, top = (round(edge / RESOLUTION) for edge in box)
    cells = np.full((right - x) * (top - y), kind, np.int8)
    return OccupancyGridUpdate(x=x, y=y, width=right - x, height=top - y, data=cells)


def distance_to(plan: Plan, boxes: Sequence[Box]) -> float:
    """Return the least distance [m] of a plan to boxes."""
    return float(clearance(room(boxes), planar_poses(plan.poses)[:, :2]).min())
