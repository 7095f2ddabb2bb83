"""Obstacles outside the map: what the scanner saw lately, and where the robot got stuck."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.planar.grid import Frame
from cairn.planar.poses import Pose, compose, distance
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
        self._cells = np.empty(0, np.int64)  # rows * columns + column, ascending
        self._stamps = np.empty(0, np.int64)

    def fits(self, frame: Frame, shape: tuple[int, int]) -> bool:
        """Return whether the cells belong to a map with this frame and shape."""
        return frame == self._frame and shape == self._shape

    def add_scan(
        self, stamp: int, pose: Pose, beams: ScanBeams, within: tuple[float, float], memory_ns: int
    ) -> None:
        """Add a scan made at `pose`; forget cells that it sees through or that are too old.

        Only hits between the distances `within` [m] from the robot count.
        """
        points = beams.points()
        apart = np.hypot(points[:, 0], points[:, 1])
        points = points[(apart > within[0]) & (apart <= within[1])]
        cells_seen = self._cell_numbers(points, pose)
        kept = self._stamps > stamp - memory_ns
        if self._cells.size and kept.any():
            cells, stamps = self._cells[kept], self._stamps[kept]
            kept = ~self._seen_through(cells, pose, beams)
            cells, stamps = cells[kept], stamps[kept]
            seen_again = np.isin(cells, cells_seen, assume_unique=True)
            fresh = np.full(cells_seen.size, stamp, np.int64)
            again = np.isin(cells_seen, cells, assume_unique=True)
            fresh[again] = np.maximum(stamp, stamps[seen_again])  # both in ascending order of cells
            cells = np.concatenate((cells[~seen_again], cells_seen))
            stamps = np.concatenate((stamps[~seen_again], fresh))
            order = np.argsort(cells)
            self._cells, self._stamps = cells[order], stamps[order]
        else:
            self._cells, self._stamps = cells_seen, np.full(cells_seen.size, stamp, np.int64)

    def remember_near(self, x: float, y: float, within: float, stamp: int) -> None:
        """Remember cells within a distance [m] of a position [m] as if seen at that time [ns]."""
        rows, columns = np.divmod(self._cells, self._shape[1])
        column, row = self._frame.cells(x, y)
        apart = np.hypot(rows + 0.5 - row, columns + 0.5 - column) * self._frame.resolution
        near = apart <= within
        self._stamps[near] = np.maximum(self._stamps[near], stamp)

    def forget(self, before: int) -> None:
        """Forget cells last seen before a time [ns]."""
        kept = self._stamps >= before
        self._cells, self._stamps = self._cells[kept], self._stamps[kept]

    def cells(self) -> NDArray[np.int64]:
        """Return rows and columns (n, 2) of the remembered cells, in a fixed order."""
        return np.column_stack(np.divmod(self._cells, self._shape[1]))

    def _cell_numbers(self, points: NDArray[np.float64], pose: Pose) -> NDArray[np.int64]:
        """Return the distinct cells that hold points (n, 2) [m] of the robot's frame."""
        turn = pose[2] - self._frame.origin[2]
        x, y = self._frame.cells(pose[0], pose[1])
        cosine = math.cos(turn) / self._frame.resolution
        sine = math.sin(turn) / self._frame.resolution
        columns = np.floor(x + cosine * points[:, 0] - sine * points[:, 1]).astype(np.int64)
        rows = np.floor(y + sine * points[:, 0] + cosine * points[:, 1]).astype(np.int64)
        inside = (rows >= 0) & (rows < self._shape[0])
        inside &= (columns >= 0) & (columns < self._shape[1])
        numbers: NDArray[np.int64] = np.unique(rows[inside] * self._shape[1] + columns[inside])
        return numbers

    def _seen_through(
        self, cells: NDArray[np.int64], pose: Pose, beams: ScanBeams
    ) -> NDArray[np.bool_]:
        """Return which of the cells a beam passes through and continues behind."""
        rows, columns = np.divmod(cells, self._shape[1])
        scanner = compose(pose, beams.start)
        x, y = self._frame.cells(scanner[0], scanner[1])
        turn = pose[2] - self._frame.origin[2]
        dx = (columns + 0.5 - x) * self._frame.resolution
        dy = (rows + 0.5 - y) * self._frame.resolution
        apart = np.hypot(dx, dy)
        count = beams.angles.size
        if count < 2 or beams.angles[0] == beams.angles[1]:  # the beams' width is unknown
            return np.zeros(cells.size, np.bool_)
        first, step = beams.angles[0], beams.angles[1] - beams.angles[0]
        bearing = np.arctan2(dy, dx) - turn - first
        full = 2.0 * math.pi
        nearest = np.rint((bearing % full if step > 0 else -(-bearing % full)) / step)
        # After a full turn the first beam follows the last one.
        nearest %= max(1.0, np.rint(full / abs(step)))
        known = nearest < count
        ranges = beams.ranges[np.where(known, nearest, 0).astype(np.int64)]
        through: NDArray[np.bool_] = known & (ranges > apart + _BEHIND_M)
        return through & (apart < beams.reach)


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
        self._stay: tuple[int, int, Pose] | None = None  # goal id, start time, pose

    def is_stuck(self, now: int, status: MotionStatus, pose: Pose) -> bool:
        """Return whether the robot is stuck at `now` [ns]; the time counts again from then on."""
        if status.state not in (MotionStatus.MOVING, MotionStatus.BLOCKED):
            self._stay = None
            return False
        stay = self._stay
        if stay is None or stay[0] != status.goal_id or distance(stay[2], pose) > _STUCK_M:
            self._stay = status.goal_id, now, pose
            return False
        blocked = status.state == MotionStatus.BLOCKED
        if now - stay[1] < (_STUCK_BLOCKED_NS if blocked else _STUCK_MOVING_NS):
            return False
        self._stay = status.goal_id, now, pose
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
