"""Scans that wait for odometry that is late."""

from __future__ import annotations

from collections import deque

from cairn.planar.pose_tracker import EXACT_S, end_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn.system.clock import SECOND

# A scan waits for odometry for no longer than this [s]: motion control and the velocity gate stop
# the robot by then. At most so many scans wait, those of 0.5 s at 40 Hz.
_LONGEST_WAIT_S, _MOST_WAITING = 0.5, 20


class WaitingScans:
    """Scans that wait for odometry that is late: until it has nearly reached their last beam.

    With odometry that is on time no scan waits.
    """

    def __init__(self, nearly_s: float = EXACT_S) -> None:
        """Release a scan when odometry is no more than `nearly_s` [s] older."""
        self._nearly_s = nearly_s
        self._scans: deque[LaserScan] = deque(maxlen=_MOST_WAITING)

    @property
    def waiting(self) -> tuple[LaserScan, ...]:
        """The scans that still wait, oldest first."""
        return tuple(self._scans)

    def add(self, scan: LaserScan) -> None:
        """Add a scan; if too many wait, drop the oldest."""
        self._scans.append(scan)

    def release(self, newest: int | None, now: int) -> list[LaserScan]:
        """Return the scans that are due at `now` [ns] with odometry up to `newest` [ns].

        These are also scans for which no odometry arrived in time, or that are from the future.
        """
        ready = []
        while self._scans and not self._waits(end_of(self._scans[0]), newest, now):
            ready.append(self._scans.popleft())
        return ready

    def clear(self) -> None:
        """Drop all scans, as when odometry restarts."""
        self._scans.clear()

    def _waits(self, end: int, newest: int | None, now: int) -> bool:
        nearly = self._nearly_s * SECOND
        if newest is None or newest >= end - nearly:
            return False
        return -nearly <= now - end <= _LONGEST_WAIT_S * SECOND
