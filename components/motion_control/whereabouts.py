"""Where the robot is by its odometry and in the map, and how it moves."""

from __future__ import annotations

from cairn import SECOND
from cairn.planar.odometry import Added, OdometryHistory, jumped
from cairn.planar.poses import Pose, compose, distance, relative

_HORIZON_NS = 5 * SECOND
_AHEAD_S = 0.1  # the robot is taken to move on so long after the newest odometry

# A step is impossible if it is so much faster than the robot.
_FASTER = 2.0


class Whereabouts:
    """The last poses by odometry, and the last one in the map, which odometry carries on."""

    def __init__(self, speed: float, turn_speed: float) -> None:
        self._fastest, self._fastest_turn = speed, turn_speed
        self._history = OdometryHistory(_HORIZON_NS)
        self._odom: Pose = (0.0, 0.0, 0.0)
        self._pose: tuple[int, Pose] | None = None
        self.speed = 0.0
        self.turn = 0.0

    def move(self, stamp: int, odom: Pose, speed: float, turn: float) -> str:
        """Take odometry, unless it is a little older than the newest.

        Says what broke it off, "" as a rule: all that was known before is forgotten then.
        """
        newest = self._history.newest
        added = self._history.add(stamp, odom)
        if added is Added.IGNORED:
            return ""
        broken = ""
        if newest is not None and added is Added.ANEW:
            broken = f"went back in time by {(newest - stamp) / SECOND:.1f} s"
        elif newest is not None and self._is_jump(odom, (stamp - newest) / SECOND):
            broken = f"jumped by {distance(self._odom, odom):.2f} m"
            self._history.clear()
            self._history.add(stamp, odom)
        if broken:
            self._pose = None
        self._odom, self.speed, self.turn = odom, speed, turn
        return broken

    def _is_jump(self, odom: Pose, seconds: float) -> bool:
        fastest, fastest_turn = _FASTER * self._fastest, _FASTER * self._fastest_turn
        return jumped(self._odom, odom, seconds, fastest, fastest_turn)

    def locate(self, stamp: int, pose: Pose) -> None:
        """Take the pose in the map that the robot had at `stamp` [ns]."""
        self._pose = (stamp, pose)

    def odom(self, now: int) -> Pose | None:
        """The pose in the odometry frame; a little after the newest one the robot moves on.

        None if that is before all that is known.
        """
        newest = self._history.newest
        if newest is None or now <= newest:
            return self._history.at(now)
        seconds = min(_AHEAD_S, (now - newest) / SECOND)
        return compose(self._odom, (self.speed * seconds, 0.0, self.turn * seconds))

    def pose(self, now: int) -> Pose | None:
        """The pose in the map; None before the first, and if odometry began anew since."""
        if self._pose is None:
            return None
        stamp, pose = self._pose
        left, reached = self.odom(stamp), self.odom(now)
        if left is None or reached is None:
            return None
        return compose(pose, relative(left, reached))
