"""Zones of the map for motion control: edges not to drive over, and the speed that is allowed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.velocity_limits import MotionLimits, VelocityTarget
from cairn.planar.polygons import distance_to_edges, is_inside, points_near
from cairn.planar.poses import Pose
from cairn.planar.zones import zone_edges
from cairn.schemas.cairn_nav_msgs import Zone

Array = NDArray[np.float64]

# Points on edges are so far apart [m]: between two of them a robot of 0.22 m radius could reach
# 2 mm over the edge.
_SPACING_M = 0.05


@dataclass(frozen=True)
class _Area:
    name: str
    edges: Array
    speed: float = math.inf


class ZoneLimits:
    """The keepout and slow zones around the robot.

    A keepout zone in which the robot is does not hold it back: its edges count again when the whole
    robot has left it.
    """

    def __init__(self, limits: MotionLimits, zones: Sequence[Zone] = ()) -> None:
        self._limits = limits
        areas = [_Area(zone.name, zone_edges(zone), zone.speed) for zone in zones if _is_area(zone)]
        self._slow = [area for area in areas if area.speed > 0.0]
        self._keepout = [area for area in areas if area.speed == 0.0]
        self._left: set[str] = set()  # names of keepout zones in which the robot is or was just now

    def enter(self, pose: Pose) -> str:
        """Take the robot's pose; return the name of a keepout zone that it is in, or "".

        It is in it from the moment at which its center is in it until all of it is outside.
        """
        x, y, _ = pose
        for area in self._keepout:
            if is_inside(area.edges, x, y):
                self._left.add(area.name)
            elif distance_to_edges(area.edges, x, y) >= self._limits.minimum_radius:
                self._left.discard(area.name)
        return min(self._left, default="")

    def edges_near(self, pose: Pose, reach: float) -> Array:
        """Return points (n, 2) [m] in frame map on the edges within `reach` [m] not to drive over.

        Call `enter` with this pose first.
        """
        x, y, _ = pose
        parts = [
            points_near(area.edges, x, y, reach, _SPACING_M)
            for area in self._keepout
            if area.name not in self._left
        ]
        return np.vstack(parts) if parts else np.empty((0, 2))

    def nearest(self, pose: Pose) -> tuple[str, float]:
        """Return the name of the nearest keepout zone not to enter, and its distance [m]."""
        found, least = "", math.inf
        for area in self._keepout:
            apart = distance_to_edges(area.edges, pose[0], pose[1])
            if area.name not in self._left and apart < least:
                found, least = area.name, apart
        return found, least

    def speed_at(self, pose: Pose) -> float:
        """Return the speed [m/s] that slow zones allow; infinite without one near.

        It decreases before a zone, so that the robot enters it with the speed of the zone.
        """
        limits, fastest = self._limits, math.inf
        x, y, _ = pose
        for area in self._slow:
            speed = area.speed
            if not is_inside(area.edges, x, y):
                apart = distance_to_edges(area.edges, x, y) - limits.latency * limits.speed
                speed = math.sqrt(speed * speed + 2.0 * limits.braking * max(0.0, apart))
            fastest = min(fastest, speed)
        return fastest


def slowed(target: VelocityTarget, fastest: float) -> VelocityTarget:
    """Return a velocity of at most `fastest` [m/s] on the same arc."""
    if abs(target.speed) <= fastest:
        return target
    return replace(target, speed=math.copysign(fastest, target.speed))


def _is_area(zone: Zone) -> bool:
    return zone.kind in (Zone.KEEPOUT, Zone.SLOW)
