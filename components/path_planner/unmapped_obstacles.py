"""Obstacles outside the map: what the scanner saw lately, and where the robot got stuck."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.planar.grid import Frame
from cairn.planar.obstacle_memory import Clearing, ObstacleMemory
from cairn.planar.poses import Pose, distance, relative
from cairn.planar.scans import ScanBeams
from cairn.schemas.cairn_nav_msgs import MotionStatus

# A beam that continues this far [m] behind a cell shows that the cell is empty: two cells of 0.05
# m, as scan and pose are noisy. Chosen by hand; `lab/constants.yaml` has the effect of half
# and double.
_BEHIND_M = 0.1


class RecentObstacles:
    """Cells that the scanner saw occupied, each for some time or until it sees through them."""

    def __init__(self, frame: Frame, shape: tuple[int, int]) -> None:
        self._frame = frame
        self._shape = shape
        self._centers = ObstacleMemory(Clearing(behind=_BEHIND_M))  # [m] along the grid's axes

    def fits(self, frame: Frame, shape: tuple[int, int]) -> bool:
        """Return whether the cells belong to a map with this frame and shape."""
        return frame == self._frame and shape == self._shape

    def add_scan(
        self, stamp: int, pose: Pose, beams: ScanBeams, within: tuple[float, float], memory_ns: int
    ) -> None:
        """Add a scan made at `pose`; forget cells that it sees through or that are too old.

        Only hits between the distances `within` [m] from the robot count.
        """
        robot = relative(self._frame.origin, pose)
        rays = beams.rays(robot)
        # A beam without a hit sees through what is within its reach.
        seen_to = np.minimum(rays.ranges, rays.reach + _BEHIND_M)
        self._centers.clear(robot, replace(rays, ranges=seen_to), stamp - memory_ns + 1)
        hits = rays.points()
        apart = np.hypot(hits[:, 0] - robot[0], hits[:, 1] - robot[1])
        counts = (apart > within[0]) & (apart <= within[1])
        known, seen = self._numbers(self._centers.points), np.unique(self._numbers(hits[counts]))
        self._centers.see_again(stamp, np.isin(known, seen, assume_unique=True))
        rows, columns = np.divmod(np.setdiff1d(seen, known, assume_unique=True), self._shape[1])
        centers = np.column_stack((columns + 0.5, rows + 0.5)) * self._frame.resolution
        self._centers.add(stamp, centers)

    def remember_near(self, x: float, y: float, within: float, stamp: int) -> None:
        """Remember cells within a distance [m] of a position [m] as if seen at that time [ns]."""
        column, row = self._frame.cells(x, y)
        away = self._centers.points - np.array([column, row]) * self._frame.resolution
        self._centers.see_again(stamp, np.hypot(away[:, 0], away[:, 1]) <= within)

    def forget(self, before: int) -> None:
        """Forget cells last seen before a time [ns]."""
        self._centers.forget_before(before)

    def cells(self) -> NDArray[np.int64]:
        """Return rows and columns (n, 2) of the remembered cells, in a fixed order."""
        numbers = np.sort(self._numbers(self._centers.points))
        return np.column_stack(np.divmod(numbers, self._shape[1]))

    def _numbers(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return row * columns + column of the cells of the map that hold points (n, 2) [m]."""
        columns, rows = np.floor(points / self._frame.resolution).astype(np.int64).T
        inside = (rows >= 0) & (rows < self._shape[0]) & (columns >= 0) & (columns < self._shape[1])
        numbers: NDArray[np.int64] = rows[inside] * self._shape[1] + columns[inside]
        return numbers


# The robot is stuck when it has moved no further than this [m] for so long [ns]: while motion
# control reports that it is blocked, or that it moves. The first time is less than AutoMove waits
# until it recovers (`blocked_s`, 3 s), so that a new path comes first. Chosen by hand;
# `lab/constants.yaml` has the effect of half and double.
_STUCK_M = 0.2
_STUCK_BLOCKED_NS, _STUCK_MOVING_NS = round(2.2 * SECOND), 6 * SECOND
# Positions nearer to one another [m] are the same one: less than the radius around one (0.45 m,
# `AVOIDED_M`).
_SAME_POSITION_M = 0.3


class StuckDetector:
    """Detects that the robot follows a path but does not progress."""

    def __init__(self) -> None:
        self._stay: tuple[int, int, Pose] | None = None  # command id, start time, pose

    def is_stuck(self, now: int, status: MotionStatus, pose: Pose) -> bool:
        """Return whether the robot is stuck at `now` [ns]; the time counts again from then on."""
        if status.state not in (MotionStatus.MOVING, MotionStatus.BLOCKED):
            self._stay = None
            return False
        stay = self._stay
        if stay is None or stay[0] != status.command_id or distance(stay[2], pose) > _STUCK_M:
            self._stay = status.command_id, now, pose
            return False
        blocked = status.state == MotionStatus.BLOCKED
        if now - stay[1] < (_STUCK_BLOCKED_NS if blocked else _STUCK_MOVING_NS):
            return False
        self._stay = status.command_id, now, pose
        return True


class AvoidedPositions:
    """Positions x, y [m] in the map where the robot got stuck, each avoided for some time."""

    def __init__(self) -> None:
        self._until: dict[tuple[float, float], int] = {}

    def add(self, position: tuple[float, float], until: int) -> None:
        """Avoid a position until that time [ns]."""
        self._until = {
            known: time
            for known, time in self._until.items()
            if math.dist(known, position) > _SAME_POSITION_M
        }
        self._until[position] = until

    def forget(self, now: int) -> None:
        """Forget the positions that have expired at that time [ns]."""
        self._until = {known: until for known, until in self._until.items() if until > now}

    def positions(self) -> tuple[tuple[float, float], ...]:
        """Return the positions to avoid."""
        return tuple(self._until)
