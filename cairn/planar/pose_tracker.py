"""Pose tracker: the robot's pose at any recent time, carried forward by odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cairn.planar.odometry import OdometryChange, OdometryHistory, WheelLimits
from cairn.planar.poses import Pose, compose, distance, relative
from cairn.planar.scans import sweep_s
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.sensor_msgs import LaserScan
from cairn.system.clock import SECOND

EXACT_S = 0.1
"""A pose is extrapolated for so long [s] as if it were measured.

Meanwhile the simulated robot's accelerations of 0.8 m/s^2 and 3 rad/s^2 displace it by 4 mm and
0.015 rad: at 1 m that is the noise of its scanner, 15 mm. Odometry at 10 Hz is never older.
"""


@dataclass(frozen=True)
class Sweep:
    """Poses of the base in the odometry frame at the first (`start`) and last beam of a scan."""

    start: Pose
    end: Pose
    end_ns: int

    @property
    def motion(self) -> Pose:
        """The pose of the base at the last beam, as seen from where it was at the first one."""
        return relative(self.start, self.end)


def sweep_of(scan: LaserScan, odometry_at: Callable[[int], Pose | None]) -> Sweep | None:
    """Return where the base was while a scan was taken.

    Args:
        scan: Its stamp is the time of the first beam.
        odometry_at: Returns the base's pose in the odometry frame at a time [ns], None if unknown,
            as `OdometryHistory.at` and `PoseTracker.odometry_at` do.

    Returns:
        None if odometry does not reach back to the first beam.

    """
    start_ns = to_ns(scan.header.stamp)
    end_ns = end_of(scan)
    start, end = odometry_at(start_ns), odometry_at(end_ns)
    return None if start is None or end is None else Sweep(start, end, end_ns)


def end_of(scan: LaserScan) -> int:
    """Return the time of the last beam [ns]."""
    return to_ns(scan.header.stamp) + round(sweep_s(scan) * SECOND)


class PoseTracker:
    """Tracks the robot in the odometry frame, and in the map from the last pose known there.

    After a jump of odometry, or when time is set back, everything before it is forgotten: the pose
    in the map is unknown until one arrives that is newer.
    """

    def __init__(
        self,
        horizon_s: float = 5.0,
        fastest: float = 2.0,
        fastest_turn: float = 4.0,
        extrapolation_s: float = 0.0,
    ) -> None:
        """Track over the last `horizon_s` [s].

        A step is a jump if it is faster than `fastest` [m/s] or `fastest_turn` [rad/s]. For
        `extrapolation_s` [s] after the newest odometry the robot is assumed to keep its velocity;
        later it is assumed to stand.
        """
        self._extrapolation_s = extrapolation_s
        self._history = OdometryHistory[int](
            round(horizon_s * SECOND), WheelLimits(fastest, fastest_turn)
        )
        self._odometry: Pose = (0.0, 0.0, 0.0)
        self._pose: tuple[int, Pose] | None = None
        self.speed = 0.0
        """The newest speed [m/s]."""
        self.turn = 0.0
        """The newest angular velocity [rad/s]."""
        self.change = ""
        """The last jump or reset in words, with its size."""

    @property
    def waits_for_pose(self) -> bool:
        """Whether no pose in the map has arrived since odometry jumped or was reset."""
        return self._pose is None and self._history.restarted is not None

    @property
    def newest(self) -> int | None:
        """Time [ns] of the newest odometry; None before the first."""
        return self._history.newest

    def late_s(self, now: int) -> float:
        """Return how much [s] older odometry is at `now` [ns] than extrapolation is exact for.

        So long the robot may have moved otherwise than `odometry_at` and `pose_at` assume.
        """
        newest = self._history.newest
        return 0.0 if newest is None else max(0.0, (now - newest) / SECOND - EXACT_S)

    @property
    def last_pose(self) -> Pose | None:
        """The last pose in the map as it arrived; None before the first, and after a restart."""
        return self._pose[1] if self._pose is not None else None

    def add_odometry(
        self, stamp: int, pose: Pose, speed: float = 0.0, turn: float = 0.0
    ) -> OdometryChange:
        """Add a pose in the odometry frame at `stamp` [ns], and the velocities [m/s], [rad/s].

        Late odometry completes the past; only the newest is compared with the last pose.
        """
        newest = self._history.newest
        change = self._history.add(stamp, pose)
        if change in (OdometryChange.LATE, OdometryChange.OUTDATED):
            return change
        if change is OdometryChange.RESET:
            assert newest is not None  # otherwise there is nothing to go back from
            self.change = f"went back in time by {(newest - stamp) / SECOND:.1f} s"
            self._pose = None
        elif change is OdometryChange.JUMPED:
            self.change = f"jumped by {distance(self._odometry, pose):.2f} m"
            if self._pose is not None and self._pose[0] < stamp:
                self._pose = None
        self._odometry, self.speed, self.turn = pose, speed, turn
        return change

    def set_pose(self, stamp: int, pose: Pose) -> None:
        """Set the pose in the map at `stamp` [ns]; ignored if odometry restarted after that."""
        restarted = self._history.restarted
        if restarted is None or stamp >= restarted:
            self._pose = stamp, pose

    def odometry_at(self, stamp: int) -> Pose | None:
        """Return the pose in the odometry frame at `stamp` [ns]; None before the oldest known."""
        newest = self._history.newest
        if newest is None or stamp <= newest or self._extrapolation_s == 0.0:
            return self._history.at(stamp)
        seconds = min(self._extrapolation_s, (stamp - newest) / SECOND)
        return compose(self._odometry, (self.speed * seconds, 0.0, self.turn * seconds))

    def pose_at(self, stamp: int) -> Pose | None:
        """Return the pose in the map at `stamp` [ns]; None if it is not known.

        That is the last pose set, carried forward by odometry. It is not known before the first
        pose, since odometry restarted, or where odometry does not reach back to both times.
        """
        if self._pose is None:
            return None
        since, pose = self._pose
        start, end = self.odometry_at(since), self.odometry_at(stamp)
        if start is None or end is None:
            return None
        return compose(pose, relative(start, end))

    def sweep(self, scan: LaserScan) -> Sweep | None:
        """Return where the base was during a scan; None if odometry does not reach back to it."""
        return sweep_of(scan, self.odometry_at)
