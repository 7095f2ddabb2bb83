"""The path planner on the bus: a test scripts the robot's surroundings and reads the plans."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cairn.planar.grid import OccupancyCells
from cairn.planar.messages import planar_poses
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import Plan
from cairn.schemas.map_msgs import OccupancyGridUpdate
from tests.components.path_planner.rooms import (
    RESOLUTION,
    Box,
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


def now(it: Any) -> float:
    return float(it.executor.now()) / 1e9


def stay(
    it: Any, grid: OccupancyCells, duration: float, pose: Pose = HERE, health: float = 1.0
) -> None:
    """Let the robot stand for some time and scan a room ten times per second."""
    for _ in range(round(duration * 10)):
        it.wait(0.1)
        it.give("odom", odom_at((0.0, 0.0, 0.0), now(it)))
        it.give("scan", scan_of(grid, pose, now(it)))
        it.give("localization", pose_at(pose, now(it), health))


def window(box: Box, kind: int) -> OccupancyGridUpdate:
    x, y, right, top = (round(edge / RESOLUTION) for edge in box)
    cells = np.full((right - x) * (top - y), kind, np.int8)
    return OccupancyGridUpdate(x=x, y=y, width=right - x, height=top - y, data=cells)


def clear_of(plan: Plan, boxes: Sequence[Box]) -> float:
    """The least distance [m] of a plan to boxes."""
    return float(clearance(room(boxes), planar_poses(plan.poses)[:, :2]).min())
