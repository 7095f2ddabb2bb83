"""Rooms to plan in, as maps and messages, and scans of them."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn import from_ns
from cairn.planar.grid import Frame, OccupancyCells, map_message
from cairn.planar.messages import pose_message
from cairn.planar.poses import Pose
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, NavCommand
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

RESOLUTION = 0.05
Box = tuple[float, float, float, float]
"""x and y [m] of two opposite corners."""


def room(
    boxes: Sequence[Box] = (),
    size: tuple[float, float] = (9.0, 7.0),
    unknown: Sequence[Box] = (),
    origin: Pose = (0.0, 0.0, 0.0),
) -> OccupancyCells:
    """A walled room with boxes, by positions [m] relative to the corner of its map."""
    values = np.zeros((round(size[1] / RESOLUTION), round(size[0] / RESOLUTION)), np.int8)
    values[:2], values[-2:], values[:, :2], values[:, -2:] = 100, 100, 100, 100
    for kind, places in ((-1, unknown), (100, boxes)):
        for x0, y0, x1, y1 in places:
            columns = slice(round(x0 / RESOLUTION), round(x1 / RESOLUTION))
            values[round(y0 / RESOLUTION) : round(y1 / RESOLUTION), columns] = kind
    return OccupancyCells(values, Frame(RESOLUTION, origin))


def wall_with_door(width: float, at: float = 4.5, low: float = 2.0) -> list[Box]:
    """A wall across the room at x = `at` with a door from y = `low` over its width [m]."""
    return [(at, 0.0, at + 0.1, low), (at, low + width, at + 0.1, 7.0)]


def seconds(time: float) -> Time:
    return from_ns(round(time * 1e9))


def as_map(grid: OccupancyCells) -> OccupancyGrid:
    return map_message(Header(frame_id="map"), grid, Time())


def pose_at(pose: Pose, time: float, health: float = 1.0) -> LocalizationEstimate:
    return LocalizationEstimate(
        header=Header(stamp=seconds(time), frame_id="map"),
        located=True,
        pose=PoseWithCovariance(pose=pose_message(pose)),
        health=health,
    )


def odom_at(pose: Pose, time: float) -> Odometry:
    header = Header(stamp=seconds(time), frame_id="odom")
    return Odometry(header=header, pose=PoseWithCovariance(pose=pose_message(pose)))


def not_located(reason: str) -> LocalizationEstimate:
    return LocalizationEstimate(reason=reason)


def follow(goal: Pose, command_id: int = 1) -> NavCommand:
    return NavCommand(command_id=command_id, behavior=NavCommand.FOLLOW, goal=pose_message(goal))


def stand(command_id: int) -> NavCommand:
    return NavCommand(command_id=command_id, behavior=NavCommand.STAND)


def scan_of(grid: OccupancyCells, pose: Pose, time: float, beams: int = 360) -> LaserScan:
    """The scan of a map from a pose, by small steps along each beam."""
    angles = -math.pi + 2 * math.pi / beams * np.arange(beams)
    distances = np.arange(0.05, 8.0, 0.02)
    x = pose[0] + np.cos(pose[2] + angles)[:, None] * distances
    y = pose[1] + np.sin(pose[2] + angles)[:, None] * distances
    rows, columns = grid.values.shape
    row = np.clip((y / RESOLUTION).astype(int), 0, rows - 1)
    column = np.clip((x / RESOLUTION).astype(int), 0, columns - 1)
    hit = grid.values[row, column] > 50
    ranges = np.where(hit.any(axis=1), distances[hit.argmax(axis=1)], np.inf)
    return LaserScan(
        header=Header(stamp=seconds(time), frame_id="laser"),
        angle_min=-math.pi,
        angle_max=math.pi,
        angle_increment=2 * math.pi / beams,
        range_min=0.05,
        range_max=8.0,
        ranges=ranges.astype(np.float32),
    )


def clearance(grid: OccupancyCells, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The distance [m] of points x, y (n, 2) to the nearest edge of an obstacle cell."""
    rows, columns = np.nonzero(grid.values > 50)
    low = np.stack((columns, rows), axis=1) * grid.frame.resolution
    low = low + np.array(grid.frame.origin[:2])
    gap = np.maximum(low - points[:, None, :], points[:, None, :] - low - grid.frame.resolution)
    apart: NDArray[np.float64] = np.hypot(*np.moveaxis(np.maximum(gap, 0.0), 2, 0)).min(axis=1)
    return apart
