"""Whether the odometry of a foreign base can be relied on, and its continuation where it breaks."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planar.messages import planar_pose
from planar.poses import Pose, compose, distance, inverse, wrap
from schemas.nav_msgs import Odometry

_UNIT = 0.05  # how far the norm of an orientation may be off 1
_SLACK_M = 0.1
_SLACK_RAD = 0.2
_SLACK_S = 0.1  # a way within this more of time than has passed is possible


@dataclass(frozen=True)
class Expected:
    """What the base is known for: frames, and how fast it can be at most [m/s, rad/s]."""

    odom_frame: str
    base_frame: str
    speed: float
    turn: float


def refusal(message: Odometry, expected: Expected) -> str | None:
    """Why a message of odometry cannot be used, as a sentence; None if it can."""
    frames = (message.header.frame_id, message.child_frame_id)
    if frames != (expected.odom_frame, expected.base_frame):
        return (
            f"the base's odometry is of frame {frames[1]!r} in {frames[0]!r}, not of "
            f"{expected.base_frame!r} in {expected.odom_frame!r}; set base_frame and odom_frame"
        )
    q = message.pose.pose.orientation
    norm = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if abs(norm - 1.0) > _UNIT:
        return f"the orientation in the base's odometry has norm {norm:.3g}, so it is none"
    return None


class Continuity:
    """Leads the base's poses on where they jump, as when the base is started anew.

    Frame `odom` is continuous by its definition (REP 105): localization relies on it.
    """

    def __init__(self, expected: Expected) -> None:
        self._expected = expected
        self._offset: Pose = (0.0, 0.0, 0.0)
        self._last: tuple[float, Pose] | None = None
        self.jumps = 0

    @property
    def moved(self) -> bool:
        """Whether poses are other than the base's own."""
        return self._offset != (0.0, 0.0, 0.0)

    def pose(self, time_s: float, message: Odometry) -> Pose:
        """The pose to send on for a message of time `time_s` [s]."""
        given = planar_pose(message.pose.pose)
        if self._last is not None and self._jumped(time_s - self._last[0], self._last[1], given):
            self.jumps += 1
            before = compose(self._offset, self._last[1])
            self._offset = compose(before, inverse(given))
        self._last = (time_s, given)
        return compose(self._offset, given)

    def _jumped(self, seconds: float, before: Pose, after: Pose) -> bool:
        seconds += _SLACK_S
        return (
            distance(before, after) > self._expected.speed * seconds + _SLACK_M
            or abs(wrap(after[2] - before[2])) > self._expected.turn * seconds + _SLACK_RAD
        )
