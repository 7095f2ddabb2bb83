"""Where the robot is in the map: its last pose, which odometry carries on."""

from __future__ import annotations

from enum import Enum, auto

from cairn import SECOND
from cairn.planar.odometry import Added, OdometryHistory, jumped
from cairn.planar.poses import Pose

_HORIZON_NS = 3 * SECOND

# A step is a jump if it is faster than this [m/s, rad/s].
_FASTEST, _FASTEST_TURN = 2.0, 4.0


class Moved(Enum):
    """What odometry tells: that the robot moved, or that what came before no longer counts."""

    ON = auto()
    JUMPED = auto()
    SET_BACK = auto()
    """Time was set back."""


class Whereabouts:
    """The last pose in the map, and odometry since; none is carried on across a jump."""

    def __init__(self) -> None:
        self._history = OdometryHistory(_HORIZON_NS)
        self._odom: Pose = (0.0, 0.0, 0.0)
        self._pose: tuple[int, Pose] | None = None
        self._anew: int | None = None

    @property
    def lost(self) -> bool:
        """Whether no pose has come since odometry began anew."""
        return self._pose is None and self._anew is not None

    def move(self, stamp: int, odom: Pose) -> Moved:
        """Take odometry, unless it is a little older than the newest."""
        newest = self._history.newest
        added = self._history.add(stamp, odom)
        if added is Added.IGNORED:
            return Moved.ON
        moved = Moved.ON
        if added is Added.ANEW:
            moved, self._anew, self._pose = Moved.SET_BACK, stamp, None
        elif newest is not None and self._is_jump(odom, (stamp - newest) / SECOND):
            moved, self._anew = Moved.JUMPED, stamp
            self._history.clear()
            self._history.add(stamp, odom)
            if self._pose is not None and self._pose[0] < stamp:
                self._pose = None
        self._odom = odom
        return moved

    def locate(self, stamp: int, pose: Pose) -> None:
        """Take the pose in the map at `stamp` [ns], unless odometry began anew after it."""
        if self._anew is None or stamp >= self._anew:
            self._pose = stamp, pose

    def at(self, stamp: int) -> Pose | None:
        """The pose in the map at a time; None before the first, and since odometry began anew.

        Where odometry does not reach back so far it is the last pose as it came.
        """
        if self._pose is None:
            return None
        since, pose = self._pose
        return self._history.carried(pose, since, stamp) or pose

    def _is_jump(self, odom: Pose, seconds: float) -> bool:
        return jumped(self._odom, odom, seconds, _FASTEST, _FASTEST_TURN)
