"""One goal: what is noted on the way to it, and how its end is judged."""

from __future__ import annotations

from dataclasses import dataclass

from cairn import SECOND
from cairn.planar.poses import Pose, distance, wrap
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.tools.evaluation.results import GoalResult

# So near the truth [m], [rad] a robot that was carried off has found itself.
_FOUND_M, _FOUND_RAD = 0.5, 0.5


@dataclass(frozen=True)
class Tolerance:
    """How near to its goal a robot must truly be [m], [rad]."""

    position: float
    heading: float


@dataclass
class Attempt:
    """A goal being driven to since `began_ns`; `shortest` [m] is the way to it.

    `mission_id` is the robot's number of it, None before it is known; `end` is the robot's last
    status of it.
    """

    goal: Pose
    began_ns: int
    shortest: float
    mission_id: int | None = None
    driven: float = 0.0
    recoveries: int = 0
    end: NavigationStatus | None = None
    carried_ns: int | None = None
    found_ns: int | None = None

    def lost(self, stamp: int, told: Pose, true: Pose) -> bool:
        """Whether the robot was carried off and has not found itself with this pose either."""
        if self.carried_ns is None:
            return False
        near = distance(told, true) <= _FOUND_M and abs(wrap(told[2] - true[2])) <= _FOUND_RAD
        if self.found_ns is None and near:
            self.found_ns = stamp
        return self.found_ns is None

    def judged(self, here: Pose, now: int, tolerance: Tolerance, given_up: str = "") -> GoalResult:
        """What came of it, the robot being truly `here`; `given_up`: why it is not waited for."""
        error, turn = distance(here, self.goal), abs(wrap(here[2] - self.goal[2]))
        there = error <= tolerance.position and turn <= tolerance.heading
        claimed = self.end is not None and self.end.state == NavigationStatus.SUCCEEDED
        reason = given_up or (self.end.reason if self.end is not None else "")
        if claimed and not there:
            reason = f"said to be there, but was {error:.2f} m off and turned by {turn:.2f} rad"
        found_ns, carried_ns = self.found_ns, self.carried_ns
        return GoalResult(
            x=self.goal[0],
            y=self.goal[1],
            theta=self.goal[2],
            reached=claimed and there,
            claimed=claimed,
            reason=reason,
            shortest=self.shortest,
            driven=self.driven,
            seconds=(now - self.began_ns) / SECOND,
            recoveries=self.recoveries,
            end_error=error,
            end_turn=turn,
            kidnapped=carried_ns is not None,
            relocalized_s=None
            if found_ns is None or carried_ns is None
            else (found_ns - carried_ns) / SECOND,
        )
