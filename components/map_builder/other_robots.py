"""Keeps other robots, which stand in scans as obstacles do, out of the grid map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cairn import SECOND
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays
from cairn.visual_map.shared_record import MOST_ROBOTS

_FRESH_S: Final = 3.0
"""Robots publish where they are once a second."""
# Ends of rays this near a robot's edge [m] are of the robot: the positions of both have errors, of
# up to 0.15 m each where scans are integrated. Chosen by hand.
_MARGIN_M: Final = 0.2
_LARGEST_M: Final = 2.0


@dataclass(frozen=True)
class _Standing:
    x: float
    y: float
    radius: float
    received_ns: int


class OtherRobots:
    """Where other robots of the fleet are, as they have published it."""

    def __init__(self) -> None:
        self._robots: dict[str, _Standing] = {}

    def note(self, robot: str, x: float, y: float, radius: float, now_ns: int) -> None:
        """Note where a robot is, NaN if it does not know it, and its radius [m]."""
        known = len(self._robots) < MOST_ROBOTS or robot in self._robots
        if known and math.isfinite(x + y) and radius <= _LARGEST_M:
            self._robots[robot] = _Standing(x, y, radius, now_ns)
        else:
            self._robots.pop(robot, None)

    def out_of(self, rays: Rays, pose: Pose, now_ns: int) -> Rays:
        """Return the rays of a scan from `pose` without those that end at another robot."""
        near = list(self._near(pose, rays.reach, now_ns))
        if not near:
            return rays
        x, y, theta = pose
        cosine, sine = math.cos(theta), math.sin(theta)
        ends_x = rays.starts[:, 0] + rays.ranges * np.cos(rays.angles)
        ends_y = rays.starts[:, 1] + rays.ranges * np.sin(rays.angles)
        ranges = rays.ranges.copy()
        for one in near:
            dx, dy = one.x - x, one.y - y
            there = np.hypot(ends_x - (cosine * dx + sine * dy), ends_y - (cosine * dy - sine * dx))
            ranges[there <= one.radius + _MARGIN_M] = np.nan
        return replace(rays, ranges=ranges)

    def _near(self, pose: Pose, reach: float, now_ns: int) -> Iterator[_Standing]:
        for robot, one in list(self._robots.items()):
            if abs(now_ns - one.received_ns) > _FRESH_S * SECOND:
                del self._robots[robot]
            elif math.hypot(one.x - pose[0], one.y - pose[1]) <= reach + one.radius + 1.0:
                yield one
