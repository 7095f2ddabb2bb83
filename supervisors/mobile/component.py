"""The control component of the navigation framework: takes orders to move and sees them done."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cairn.bus.qos import LATCHED
from cairn.clock import SECOND, from_ns
from cairn.component.handlers import on
from cairn.component.parameters import Config
from cairn.component.ports import In, Out
from cairn.errors import CairnError
from cairn.supervision.component import SupervisorComponent
from cairn.supervision.supervisor import StartFailed
from planar.messages import packed_poses, planar_pose
from schemas.cairn_nav_msgs import MoveOrder, MoveStatus
from schemas.geometry_msgs import PoseStamped
from schemas.std_msgs import Header

Goal = tuple[float, float, float]
Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]

_ENDS = {
    MoveStatus.SUCCEEDED: "succeeded",
    MoveStatus.FAILED: "failed",
    MoveStatus.CANCELLED: "cancelled",
}


class MobileSupervisorConfig(Config):
    """What the robot is to do."""

    mission: tuple[tuple[Coordinate, Coordinate, Coordinate], ...] = Field(
        (), description="Goals to be driven to from the start: x [m], y [m], heading [rad]."
    )
    automove: str = Field(
        "automove", description="The child that carries orders out; loaded on the first order."
    )
    finish: bool = Field(
        False, description="Whether to end once the mission is done, and with it the deployment."
    )


class MobileSupervisor(SupervisorComponent):
    """Keeps the base, the range scanner and AutoMove running (paper, step 1).

    Takes orders to move (requests `go` and `cancel`, topic `goal_pose`, parameter `mission`), loads
    AutoMove on the first, and keeps each order until it has its result, so that an AutoMove that
    was started anew goes on with it.
    """

    config: MobileSupervisorConfig

    goal_pose: In[PoseStamped] = In(optional=True)
    move_status: In[MoveStatus] = In(qos=LATCHED, optional=True)
    order: Out[MoveOrder] = Out(qos=LATCHED)

    _order_id = 0
    _goals: tuple[Goal, ...] = ()
    _at = 0
    _mission_id = 0

    def on_activate(self) -> None:
        """Start the children; begin with the mission, if there is one."""
        super().on_activate()
        if self.config.mission and self.restarts == 0:
            self._mission_id = self._go(self.config.mission)

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Take `go` with `goals` [[x, y, heading], ...], `cancel`, or a supervisor's request."""
        if verb == "go" and set(arguments) == {"goals"}:
            return {"order_id": self._go(checked_goals(arguments["goals"]))}
        if verb == "cancel" and not arguments:
            return {"order_id": self._cancel()}
        return super().on_request(verb, arguments)

    @on("goal_pose")
    def go_to(self, goal: PoseStamped) -> None:
        """Take a goal from RViz or any other node."""
        try:
            self._go((planar_pose(goal.pose),))
        except CairnError as error:
            self.log.error("the order to move is not carried out: %s", error)

    @on("move_status")
    def follow(self, status: MoveStatus) -> None:
        """Note how far the order has come; let go of it when it has its result."""
        if status.order_id != self._order_id or not self._goals:
            return
        if status.state in _ENDS:
            self.log.info(
                "order %d %s: %s", status.order_id, _ENDS[status.state], status.reason or "-"
            )
            self._goals = ()
            self._tell()
            if status.order_id == self._mission_id and self.config.finish:
                self.finish(f"the mission {_ENDS[status.state]}: {status.reason}")
        elif status.goal > self._at:
            self._at = status.goal
            self._tell()

    def _go(self, goals: Sequence[Goal]) -> int:
        try:
            self.children.load(self.config.automove)
        except StartFailed as error:
            raise CairnError(f"AutoMove cannot be loaded: {error}") from error
        # Larger than any that a forerunner of this supervisor gave.
        self._order_id = max(self._order_id + 1, self.clock.now() // SECOND & 0x7FFFFFFF)
        self._goals, self._at = tuple(goals), 0
        self._tell()
        return self._order_id

    def _cancel(self) -> int:
        if not self._goals:
            raise CairnError(f"{self.name}: there is no order to cancel")
        # Kept until AutoMove says that it stands.
        self.order.publish(self._message(()))
        return self._order_id

    def _tell(self) -> None:
        self.order.publish(self._message(self._goals))

    def _message(self, goals: Sequence[Goal]) -> MoveOrder:
        return MoveOrder(
            header=Header(stamp=from_ns(self.clock.now()), frame_id="map"),
            order_id=self._order_id,
            first=self._at,
            goals=packed_poses(np.array(goals, np.float64).reshape(-1, 3)),
        )


def checked_goals(given: Any) -> list[Goal]:
    """Goals of a request; `CairnError` says which is wrong."""
    if not isinstance(given, list) or not given:
        raise CairnError("an order to move has at least one goal")
    goals = []
    for number, goal in enumerate(given, start=1):
        numbers = isinstance(goal, list) and all(isinstance(v, int | float) for v in goal)
        if not numbers or len(goal) != 3:
            raise CairnError(f"goal {number} = {goal!r}: give x [m], y [m] and heading [rad]")
        if not all(math.isfinite(value) and abs(value) <= 1e5 for value in goal):
            raise CairnError(f"goal {number} = {goal!r}: x, y and heading must be finite")
        goals.append((float(goal[0]), float(goal[1]), float(goal[2])))
    return goals
