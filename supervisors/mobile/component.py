"""The control component of the navigation framework: takes orders to move and sees them done."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cairn import LATCHED, SECOND, CairnError, Config, In, Out, StartFailed, Supervisor, from_ns, on
from cairn.planar.messages import packed_poses, planar_pose
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    NavigateGoal,
    NavigationStatus,
)
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.std_msgs import Header
from cairn.supervisors.mobile.mission import (
    FARTHEST,
    Goal,
    Order,
    checked_goals,
    checked_token,
    save,
    saved,
)

Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]

# An order that is under way whenever this component dies may be why it does.
_RESUMED_AT_MOST = 3


class MobileSupervisorConfig(Config):
    """What the robot is to do."""

    mission: tuple[tuple[Coordinate, Coordinate, Coordinate], ...] = Field(
        (), description="Goals to be driven to from the start: x [m], y [m], heading [rad]."
    )
    automove: str = Field(
        "automove", description="The child that carries orders out; loaded on the first order."
    )
    finish: bool = Field(
        False,
        description="Whether to end once the mission is done, and with it the deployment; where an "
        "order pre-empts the mission, once that order is.",
    )
    state_file: Path | None = Field(
        None,
        description="Where to keep the order, so that a supervisor whose process died goes on with "
        "it; none: it is lost, and the robot stands.",
    )


class MobileSupervisor(Supervisor):
    """Keeps the base, the range scanner and AutoMove running (paper, step 1).

    Takes orders to move (requests `go`, `cancel` and `order`, topic `goal_pose`, parameter
    `mission`), loads AutoMove on the first, and keeps each order until it has its result, so that
    an AutoMove that was started anew goes on with it.
    """

    config: MobileSupervisorConfig

    goal_pose: In[PoseStamped] = In(optional=True)
    navigation_status: In[NavigationStatus] = In(qos=LATCHED.with_depth(20), optional=True)
    navigate_goal: Out[NavigateGoal] = Out(qos=LATCHED)

    _order: Order | None = None

    def on_configure(self) -> None:
        """See that the order can be kept; one of an earlier run is not carried out."""
        file = self.config.state_file
        if file is None:
            return
        if not file.parent.is_dir():
            raise CairnError(f"{file.parent}: no such folder to keep the order in (state_file)")
        if self.restarts == 0:
            file.unlink(missing_ok=True)

    def on_activate(self) -> None:
        """Start the children; begin with the mission, or go on with the order there was."""
        super().on_activate()
        if self.restarts > 0:
            self._resume()
        elif self.config.mission:
            self._go(self.config.mission, mission=True)

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `go` with `goals` [[x, y, heading], ...], `cancel`, `order`; else a supervisor's.

        `go` may choose a `token` for its order. `cancel` may name the `mission_id` or the `token`
        that it means, else it is whichever order is under way.
        """
        if verb == "go" and {"goals"} <= set(arguments) <= {"goals", "token"}:
            goals, token = checked_goals(arguments["goals"]), checked_token(arguments.get("token"))
            return {"mission_id": self._go(goals, token=token).mission_id}
        if verb == "cancel" and set(arguments) <= {"mission_id", "token"}:
            return {"mission_id": self._cancel(**arguments)}
        if verb == "mission" and not arguments:
            return self._order.model_dump(mode="json") if self._order is not None else None
        return super().on_request(verb, arguments)

    @on("goal_pose")
    def go_to(self, goal: PoseStamped) -> None:
        """Take a goal from RViz or any other node."""
        frame = goal.header.frame_id
        try:
            if frame not in ("", "map"):
                raise CairnError(f"its goal on {self.goal_pose.topic} is in frame {frame}, not map")
            self._go(checked_goals([planar_pose(goal.pose)]))
        except CairnError as error:
            self.log.error("the order to move is not carried out: %s", error)

    @on("navigation_status")
    def follow(self, status: NavigationStatus) -> None:
        """Note how far the order has come; let go of it when it has its result."""
        order = self._order
        if order is None or order.result or status.mission_id != order.mission_id:
            return
        if status.state in NAVIGATION_END_STATES:
            done = status.state == NavigationStatus.SUCCEEDED
            self._close(order, f"{NAVIGATION_STATES[status.state]}: {status.reason}", success=done)
        elif status.goal > order.first:
            self._take(order.model_copy(update={"first": status.goal}))

    def _go(
        self, goals: tuple[Goal, ...], *, mission: bool = False, token: str | None = None
    ) -> Order:
        self._load_automove()
        before = self._order
        last = before.mission_id if before is not None else 0
        # Larger than any that a forerunner of this supervisor gave.
        now = self.clock.now()
        mission_id = max(last + 1, now // SECOND & 0x7FFFFFFF)
        order = Order(
            mission_id=mission_id,
            given_ns=now,
            goals=goals,
            mission=mission,
            in_place_of_mission=before is not None and before.of_mission and not before.result,
            token=token,
        )
        x, y, _ = goals[-1]
        via = f" by way of {len(goals) - 1} others" if len(goals) > 1 else ""
        self.log.info("order %d: go to (%.2f, %.2f)%s", mission_id, x, y, via)
        if order.in_place_of_mission and self.config.finish:
            self.log.warning(
                "the mission is pre-empted: the deployment ends with order %d", mission_id
            )
        self._take(order)
        return order

    def _load_automove(self) -> None:
        name = self.config.automove
        if name not in {child.name for child in self.children.status()}:
            raise CairnError(f"{self.name} has no child {name} to carry out orders to move")
        try:
            self.children.load(name)
        except StartFailed as error:
            raise CairnError(f"{name} cannot be loaded: {error}") from error

    def _cancel(self, *, mission_id: Any = None, token: Any = None) -> int:
        order = self._order
        if order is None or order.result or mission_id not in (None, order.mission_id):
            which = "to cancel" if mission_id is None else f"{mission_id} under way"
            raise CairnError(f"{self.name}: there is no order {which}")
        if token not in (None, order.token):
            raise CairnError(f"{self.name}: it is another's order that is under way")
        self._close(order, "canceled: on request")
        return order.mission_id

    def _resume(self) -> None:
        file = self.config.state_file
        try:
            order = saved(file) if file is not None else None
            if order is None or order.result:
                self._order = order
                return
            if order.resumed >= _RESUMED_AT_MOST:
                why = f"failed: given up after {self.name} was started anew {order.resumed} times"
                self.log.error("order %d %s", order.mission_id, why)
                self._close(order, why)
                return
            self._load_automove()
        except CairnError as error:
            self.log.error("the order to move is not gone on with: %s", error)
            return
        self.log.warning("going on with order %d", order.mission_id)
        self._take(order.model_copy(update={"resumed": order.resumed + 1}))

    def _close(self, order: Order, result: str, *, success: bool = False) -> None:
        self.log.info("order %d %s", order.mission_id, result)
        self._take(order.model_copy(update={"result": result}))
        if not self.config.finish:
            return
        if order.mission:
            self.finish(f"the mission {result}", success=success)
        elif order.in_place_of_mission:  # not before: the robot must not stop under its operator
            which = f"order {order.mission_id}"
            self.finish(f"the mission was pre-empted by {which}, which {result}", success=False)

    def _take(self, order: Order) -> None:
        """Keep the order as it is now, and tell it to AutoMove."""
        self._order = order
        file = self.config.state_file
        if file is not None:
            try:
                save(file, order)
            except OSError as error:
                self.log.error("the order cannot be kept in %s: %s", file, error.strerror)
        goals = () if order.result else order.goals
        self.navigate_goal.publish(
            NavigateGoal(
                header=Header(stamp=from_ns(order.given_ns), frame_id="map"),
                mission_id=order.mission_id,
                first=order.first,
                goals=packed_poses(np.array(goals, np.float64).reshape(-1, 3)),
            )
        )
