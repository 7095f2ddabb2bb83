"""Whether the odometry of a foreign base can be relied on, and its continuation where it breaks."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cairn.planar.poses import Pose, apart, compose, inverse
from cairn.schemas.nav_msgs import Odometry

_UNIT = 0.05  # how far the norm of an orientation may be off 1
_SLACK_M = 0.1
_SLACK_RAD = 0.2
_SLACK_S = 0.1  # a way within this more of time than has passed is possible
_ORIGIN: Pose = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Expected:
    """What the base is known for: frames, and how fast it can be at most [m/s, rad/s]."""

    odom_frame: str
    base_frame: str
    speed: float
    turn: float
    silence_s: float
    """A base that has been silent for longer may have been started anew [s]."""


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

    Frame `odom` is continuous by its definition (REP 105): localization relies on it. After a long
    silence nearly any way is possible; but a base that is at its origin then was started anew.
    """

    def __init__(self, expected: Expected) -> None:
        self._expected = expected
        self._offset = _ORIGIN
        self._last: tuple[float, Pose] | None = None
        self.jumps = 0

    @property
    def turned(self) -> float:
        """How far the poses that are sent on are turned against the base's own [rad]."""
        return self._offset[2]

    def pose(self, time_s: float, given: Pose) -> Pose:
        """The pose to send on for one that the base tells of time `time_s` [s]."""
        if self._last is not None and self._jumped(time_s - self._last[0], self._last[1], given):
            self.jumps += 1
            before = compose(self._offset, self._last[1])
            self._offset = compose(before, inverse(given))
        self._last = (time_s, given)
        return compose(self._offset, given)

    def _jumped(self, seconds: float, before: Pose, after: Pose) -> bool:
        expected, possible_s = self._expected, max(0.0, seconds) + _SLACK_S
        too_far = apart(
            before,
            after,
            expected.speed * possible_s + _SLACK_M,
            expected.turn * possible_s + _SLACK_RAD,
        )
        return too_far or (
            seconds > expected.silence_s and _at_origin(after) and not _at_origin(before)
        )


def _at_origin(pose: Pose) -> bool:
    return not apart(_ORIGIN, pose, _SLACK_M, _SLACK_RAD)
