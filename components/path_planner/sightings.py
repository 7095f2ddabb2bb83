"""What the scanner has seen in the last seconds: obstacles that the map may not hold."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import Frame
from cairn.planar.poses import Pose, compose
from cairn.planar.scans import ScanBeams

# A beam that goes on this far [m] behind a place shows that nothing stands there.
_BEHIND_M = 0.1


class RecentObstacles:
    """Cells of a map that the scanner saw occupied, each for some time or until seen empty."""

    def __init__(self, frame: Frame, shape: tuple[int, int]) -> None:
        self._frame = frame
        self._shape = shape
        self._cells = np.empty(0, np.int64)  # rows * columns + column, ascending
        self._stamps = np.empty(0, np.int64)

    def fits(self, frame: Frame, shape: tuple[int, int]) -> bool:
        """Whether the cells are those of a map that lies so and has that many rows and columns."""
        return frame == self._frame and shape == self._shape

    def see(
        self, stamp: int, pose: Pose, beams: ScanBeams, within: tuple[float, float], memory_ns: int
    ) -> None:
        """Take a scan made at `pose`, and forget what it sees through or is older than the memory.

        Only what lies between the distances `within` [m] from the robot counts.
        """
        points = beams.points()
        apart = np.hypot(points[:, 0], points[:, 1])
        points = points[(apart > within[0]) & (apart <= within[1])]
        seen = self._numbers(points, pose)
        kept = self._stamps > stamp - memory_ns
        if self._cells.size and kept.any():
            cells, stamps = self._cells[kept], self._stamps[kept]
            kept = ~self._seen_through(cells, pose, beams)
            cells, stamps = cells[kept], stamps[kept]
            anew = np.isin(cells, seen, assume_unique=True)
            fresh = np.full(seen.size, stamp, np.int64)
            again = np.isin(seen, cells, assume_unique=True)
            fresh[again] = np.maximum(stamp, stamps[anew])  # both in ascending order of cells
            cells = np.concatenate((cells[~anew], seen))
            stamps = np.concatenate((stamps[~anew], fresh))
            order = np.argsort(cells)
            self._cells, self._stamps = cells[order], stamps[order]
        else:
            self._cells, self._stamps = seen, np.full(seen.size, stamp, np.int64)

    def keep(self, x: float, y: float, within: float, stamp: int) -> None:
        """Remember what is within a distance [m] of a place [m] as if seen at that time [ns]."""
        rows, columns = np.divmod(self._cells, self._shape[1])
        column, row = self._frame.cells(x, y)
        apart = np.hypot(rows + 0.5 - row, columns + 0.5 - column) * self._frame.resolution
        near = apart <= within
        self._stamps[near] = np.maximum(self._stamps[near], stamp)

    def forget(self, before: int) -> None:
        """Forget what was last seen before a time [ns]."""
        kept = self._stamps >= before
        self._cells, self._stamps = self._cells[kept], self._stamps[kept]

    def cells(self) -> NDArray[np.int64]:
        """Rows and columns (n, 2) of what is remembered, in a fixed order."""
        return np.column_stack(np.divmod(self._cells, self._shape[1]))

    def _numbers(self, points: NDArray[np.float64], pose: Pose) -> NDArray[np.int64]:
        """The cells that hold points (n, 2) [m] given in the robot's frame, each once."""
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
        """Which of the cells a beam passes through and goes on behind."""
        rows, columns = np.divmod(cells, self._shape[1])
        scanner = compose(pose, beams.start)
        x, y = self._frame.cells(scanner[0], scanner[1])
        turn = pose[2] - self._frame.origin[2]
        dx = (columns + 0.5 - x) * self._frame.resolution
        dy = (rows + 0.5 - y) * self._frame.resolution
        apart = np.hypot(dx, dy)
        count = beams.angles.size
        if count < 2 or beams.angles[0] == beams.angles[1]:  # no telling how wide a beam is
            return np.zeros(cells.size, np.bool_)
        first, step = beams.angles[0], beams.angles[1] - beams.angles[0]
        bearing = np.arctan2(dy, dx) - turn - first
        full = 2.0 * math.pi
        nearest = np.rint((bearing % full if step > 0 else -(-bearing % full)) / step)
        # The first beam follows the last of a full turn.
        nearest %= max(1.0, np.rint(full / abs(step)))
        known = nearest < count
        ranges = beams.ranges[np.where(known, nearest, 0).astype(np.int64)]
        through: NDArray[np.bool_] = known & (ranges > apart + _BEHIND_M)
        return through & (apart < beams.reach)
