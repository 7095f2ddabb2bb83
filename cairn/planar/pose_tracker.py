"""Pose tracker: the robot's pose at any recent time, carried forward by odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cairn.planar.odometry import OdometryChange, OdometryHistory, is_jump
from cairn.planar.poses import Pose, compose, distance, relative
from cairn.planar.scans import sweep_s
from cairn.schemas.sensor_msgs import LaserScan

_NS_PER_S = 1_000_000_000


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
    stamp = scan.header.stamp
    start_ns = stamp.sec * _NS_PER_S + stamp.nanosec
    end_ns = start_ns + round(sweep_s(scan) * _NS_PER_S)
    start, end = odometry_at(start_ns), odometry_at(end_ns)
    return None if start is None or end is None else Sweep(start, end, end_ns)


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
        self._fastest, self._fastest_turn = fastest, fastest_turn
        self._extrapolation_s = extrapolation_s
        self._history = OdometryHistory(round(horizon_s * _NS_PER_S))
        self._odometry: Pose = (0.0, 0.0, 0.0)
        self._pose: tuple[int, Pose] | None = None
        self._restarted: int | None = None
        self.speed = 0.0
        """The newest speed [m/s]."""
        self.turn = 0.0
        """The newest angular velocity [rad/s]."""
        self.change = ""
        """The last jump or reset in words, with its size."""

    @property
    def waits_for_pose(self) -> bool:
        """Whether no pose in the map has arrived since odometry jumped or was reset."""
        return self._pose is None and self._restarted is not None

    @property
    def last_pose(self) -> Pose | None:
        """The last pose in the map as it arrived; None before the first, and after a restart."""
        return self._pose[1] if self._pose is not None else None

    def add_odometry(
        self, stamp: int, pose: Pose, speed: float = 0.0, turn: float = 0.0
    ) -> OdometryChange:
        """Add a pose in the odometry frame at `stamp` [ns], and the velocities [m/s], [rad/s]."""
        newest = self._history.newest
        change = self._history.add(stamp, pose)
        if change is OdometryChange.OUTDATED:
            return change
        if change is OdometryChange.RESET:
            assert newest is not None  # otherwise there is nothing to go back from
            self.change = f"went back in time by {(newest - stamp) / _NS_PER_S:.1f} s"
            self._restarted, self._pose = stamp, None
        elif newest is not None and self._is_jump(pose, (stamp - newest) / _NS_PER_S):
            change = OdometryChange.JUMPED
            self.change = f"jumped by {distance(self._odometry, pose):.2f} m"
            self._restarted = stamp
            self._history.clear()
            self._history.add(stamp, pose)
            if self._pose is not None and self._pose[0] < stamp:
                self._pose = None
        self._odometry, self.speed, self.turn = pose, speed, turn
        return change

    def set_pose(self, stamp: int, pose: Pose) -> None:
        """Set the pose in the map at `stamp` [ns]; ignored if odometry restarted after that."""
        if self._restarted is None or stamp >= self._restarted:
            self._pose = stamp, pose

    def odometry_at(self, stamp: int) -> Pose | None:
        """Return the pose in the odometry frame at `stamp` [ns]; None before the oldest known."""
        newest = self._history.newest
        if newest is None or stamp <= newest or self._extrapolation_s == 0.0:
            return self._history.at(stamp)
        seconds = min(self._extrapolation_s, (stamp - newest) / _NS_PER_S)
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

    def _is_jump(self, pose: Pose, seconds: float) -> bool:
        return is_jump(self._odometry, pose, seconds, self._fastest, self._fastest_turn)
