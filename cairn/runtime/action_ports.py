"""The action servers and clients of one running component."""

import zlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from cairn.bus.actions import (
    CANCEL_GOAL,
    FEEDBACK,
    GET_RESULT,
    SEND_GOAL,
    STATUS,
    ClientGoal,
    GoalClient,
    GoalServer,
    ServerGoal,
)
from cairn.bus.bus import Node, ServiceError
from cairn.errors import CairnError
from cairn.runtime.call_log import CallLog
from cairn.runtime.component import Component
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.loop import Scheduler
from cairn.runtime.port_owner import PortOwner
from cairn.runtime.ports import ActionClient, ActionServer, ActionSpec
from cairn.runtime.service_ports import ClientPort, ServerPort
from cairn.runtime.topic_ports import InputPort, OutputPort
from cairn.schemas.action_msgs.msg import GoalStatusArray
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.message import type_name


class ActionServerPort:
    """An action server of the component: three servers and two outputs."""

    def __init__(
        self,
        component: Component,
        spec: ActionSpec,
        action: str,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        on_goal: Callable[[Any], None],
        on_cancel: Callable[[Any], None] | None,
        call_log: CallLog | None,
    ) -> None:
        """Prepare the server of the action of that full name."""
        self._component = component
        self._goals: GoalServer[Any, Any, Any] = GoalServer(
            action, spec.action, self, on_goal, on_cancel, owner.log
        )
        self.bound = _BoundActionServer(action, self._goals)
        answers = {
            SEND_GOAL: self._goals.send_goal,
            CANCEL_GOAL: self._goals.cancel_goal,
            GET_RESULT: self._goals.get_result,
        }
        # A goal that is not valid is rejected, which ROS 2 clients understand.
        invalid = {
            SEND_GOAL: spec.action.SendGoal.Response(accepted=False),
            CANCEL_GOAL: CancelGoal.Response(return_code=CancelGoal.Response.ERROR_REJECTED),
        }
        self.servers: list[ServerPort] = []
        # While many goals arrive, earlier ones are canceled and have results nevertheless.
        for part in (CANCEL_GOAL, GET_RESULT, SEND_GOAL):
            service = spec.services()[part]
            self.servers.append(
                ServerPort(
                    service, f"{action}/{part}", owner, node, scheduler,
                    f"{on_goal.__name__} ({service.name})", answers[part], call_log,
                    invalid.get(part), tuple(self.servers),
                )
            )  # fmt: skip
        topics = {
            part: OutputPort(component.name, topic, f"{action}/{part}", owner, node, None, call_log)
            for part, topic in spec.topics().items()
        }
        self.outputs = list(topics.values())
        self.publish_feedback = topics[FEEDBACK].bound.publish
        self._status = topics[STATUS].bound

    def publish_status(self, message: GoalStatusArray) -> None:
        """Publish the status of all goals."""
        self._status.publish(message)

    def now(self) -> int:
        """Return the component's time [ns]."""
        return self._component.clock.now()

    def abort_goals(self) -> None:
        """Abort all goals: the component becomes inactive, or has failed."""
        self._goals.close()


class _BoundActionServer(ActionServer[Any, Any, Any]):
    """The action server of one component instance."""

    def __init__(self, action: str, goals: GoalServer[Any, Any, Any]) -> None:
        self._action = action
        self._goals = goals

    @property
    def action(self) -> str:
        """The full name of the action in this deployment."""
        return self._action

    @property
    def goals(self) -> Sequence[ServerGoal[Any, Any, Any]]:
        """The goals that have not ended, the oldest first."""
        return self._goals.active

    def restore(self, identity: bytes, goal: Any) -> ServerGoal[Any, Any, Any]:
        """Return a goal that was accepted before a restart, executing again."""
        return self._goals.restore(identity, goal)


class ActionClientPort:
    """An action client of the component: three clients and an input."""

    def __init__(
        self,
        component: Component,
        spec: ActionSpec,
        action: str,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        launch: LaunchRequest,
        call_log: CallLog | None,
    ) -> None:
        """Prepare the client of the action of that full name."""
        services = {
            part: ClientPort(
                component.name, service, f"{action}/{part}", owner, node, scheduler, call_log
            )
            for part, service in spec.services().items()
        }
        self.clients = list(services.values())
        goals: GoalClient[Any, Any, Any] = GoalClient(
            action,
            spec.action,
            *(
                partial(_call, services[part].bound)
                for part in (SEND_GOAL, CANCEL_GOAL, GET_RESULT)
            ),
        )
        self.feedback = InputPort(
            spec.topics()[FEEDBACK], f"{action}/{FEEDBACK}", owner, node, scheduler,
            [("feedback", goals.receive_feedback)], None, call_log,
        )  # fmt: skip
        # Of its own, so that goals do not change the component's other random numbers; another one
        # after a restart, because a server rejects a goal whose id it knows.
        seed = [launch.context.seed, zlib.crc32(action.encode()), launch.incarnation]
        identities = np.random.default_rng([*seed, zlib.crc32(component.name.encode())])
        self.bound = _BoundActionClient(
            component.name, spec, action, goals, services[SEND_GOAL], identities, owner
        )


def _call(
    client: Any,
    request: Any,
    on_response: Callable[[Any], None],
    on_failure: Callable[[ServiceError], None],
    timeout_s: float,
) -> None:
    client.call(request, on_response, on_failure, timeout_s=timeout_s)


class _BoundActionClient(ActionClient[Any, Any, Any]):
    """The action client of one component instance."""

    def __init__(
        self,
        component: str,
        spec: ActionSpec,
        action: str,
        goals: GoalClient[Any, Any, Any],
        send_goal: ClientPort,
        identities: np.random.Generator,
        owner: PortOwner,
    ) -> None:
        super().__init__(optional=spec.optional)
        self._component = component
        self._spec = spec
        self._action = action
        self._goals = goals
        self._send_goal = send_goal
        self._identities = identities
        self._owner = owner

    @property
    def action(self) -> str:
        """The full name of the action in this deployment."""
        return self._action

    @property
    def is_available(self) -> bool:
        """Whether there is a server."""
        return self._send_goal.bound.is_available

    def send(
        self,
        goal: Any,
        on_result: Callable[[int, Any], None],
        on_failure: Callable[[ServiceError], None] | None = None,
        *,
        on_accepted: Callable[[], None] | None = None,
        on_feedback: Callable[[Any], None] | None = None,
        timeout_s: float = 5.0,
    ) -> ClientGoal[Any, Any, Any]:
        """Send a goal; `CairnError` if it is of another type than the port's."""
        if not isinstance(goal, self._spec.action.Goal):
            raise CairnError(
                f"{self._component}: port {self._spec.name} sends goals of "
                f"{type_name(self._spec.action)}, not {type(goal).__qualname__}"
            )
        return self._goals.send(
            self._identities.bytes(16),
            goal,
            on_accepted or _ignore,
            on_feedback,
            on_result,
            on_failure or self._log_failure,
            timeout_s,
        )

    def _log_failure(self, error: ServiceError) -> None:
        self._owner.log.warning("a goal has failed: %s", error)


def _ignore() -> None:
    """Do nothing when a goal is accepted."""
