"""The action servers and clients of components."""

import zlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, Generic, Literal

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
from cairn.bus.bus import OnFailure, OnReply, ServiceError
from cairn.bus.qos import LATCHED
from cairn.errors import CairnError
from cairn.runtime.component import ComponentContext
from cairn.runtime.port import Port, type_of
from cairn.runtime.service_ports import Client, Server
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.action_msgs.msg import GoalStatusArray
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.message import Action, Feedback, Goal, Result, Service, type_name


class ActionServer(Port, Generic[Goal, Result, Feedback]):
    """An action that the component provides, while it is active: three servers and two outputs.

    `spin: ActionServer[Spin.Goal, Spin.Result, Spin.Feedback]`; a method decorated
    `@goal("spin")` begins to pursue each goal, one decorated `@cancel("spin")` to end it early.
    Without the latter, goals cannot be canceled. When the component becomes inactive, its goals are
    aborted.
    """

    role: ClassVar[Literal["server"]] = "server"

    @property
    def action(self) -> str:
        """The full name of the action in this deployment; `CairnError` on a declaration."""
        return self._bound_name()

    @property
    def goals(self) -> Sequence[ServerGoal[Goal, Result, Feedback]]:
        """The goals that have not ended, the oldest first; `CairnError` on a declaration."""
        self._bound_name()
        return self._goals.active

    def restore(self, identity: bytes, goal: Goal) -> ServerGoal[Goal, Result, Feedback]:
        """Return a goal that was accepted before a restart of the component, executing again.

        Its client can get the result as if nothing had happened. Raises `CairnError` on a
        declaration.
        """
        self._bound_name()
        return self._goals.restore(identity, goal)

    def services(self) -> dict[str, Server[Any, Any]]:
        """Return new ports for its three services, by their names below that of the action."""
        return {
            part: Server[Any, Any]().declare(f"{self.name}/{part}", service)
            for part, service in _services(self.interface).items()
        }

    def topics(self) -> dict[str, Out[Any]]:
        """Return new ports for its topics, by their names below that of the action."""
        status = Out[Any](LATCHED).declare(f"{self.name}/{STATUS}", GoalStatusArray)
        feedback = Out[Any]().declare(f"{self.name}/{FEEDBACK}", self.interface.FeedbackMessage)
        return {FEEDBACK: feedback, STATUS: status}

    def bind(
        self,
        context: ComponentContext,
        action: str,
        on_goal: Callable[[ServerGoal[Goal, Result, Feedback]], None],
        on_cancel: Callable[[ServerGoal[Goal, Result, Feedback]], None] | None,
    ) -> None:
        """Bind the port to an action (full name), with the handlers of its goals."""
        self._bind(context, action)
        topics = self.topics()
        for part, output in topics.items():
            output.bind(context, f"{action}/{part}")
        self.outputs = list(topics.values())
        self._goals: GoalServer[Goal, Result, Feedback] = GoalServer(
            action,
            self.interface,
            topics[FEEDBACK].publish,
            topics[STATUS].publish,
            context.clock.now,
            on_goal,
            on_cancel,
            context.log,
        )
        answers = {
            SEND_GOAL: self._goals.send_goal,
            CANCEL_GOAL: self._goals.cancel_goal,
            GET_RESULT: self._goals.get_result,
        }
        # A goal that is not valid is rejected, which ROS 2 clients understand.
        invalid = {
            SEND_GOAL: self.interface.SendGoal.Response(accepted=False),
            CANCEL_GOAL: CancelGoal.Response(return_code=CancelGoal.Response.ERROR_REJECTED),
        }
        services = self.services()
        self.servers: list[Server[Any, Any]] = []
        # While many goals arrive, earlier ones are canceled and have results nevertheless.
        for part in (CANCEL_GOAL, GET_RESULT, SEND_GOAL):
            server = services[part]
            where = f"{on_goal.__name__} ({server.name})"
            server.bind(
                context, f"{action}/{part}", where, answers[part], invalid.get(part),
                tuple(self.servers),
            )  # fmt: skip
            self.servers.append(server)

    def abort_goals(self) -> None:
        """Abort all goals: the component becomes inactive, or has failed."""
        self._goals.close()


class ActionClient(Port, Generic[Goal, Result, Feedback]):
    """An action that the component uses, while it is active: three clients and an input.

    `spin: ActionClient[Spin.Goal, Spin.Result, Spin.Feedback]`. With `optional=True` the component
    works without a server, and the check of a deployment does not require one.
    """

    role: ClassVar[Literal["client"]] = "client"

    def __init__(self, *, optional: bool = False) -> None:
        self.optional = optional

    @property
    def action(self) -> str:
        """The full name of the action in this deployment; `CairnError` on a declaration."""
        return self._bound_name()

    @property
    def is_available(self) -> bool:
        """Whether there is a server; `CairnError` on a declaration."""
        self._bound_name()
        return self._send_goal.is_available

    def send(
        self,
        goal: Goal,
        on_result: Callable[[int, Result], None],
        on_failure: OnFailure | None = None,
        *,
        on_accepted: Callable[[], None] | None = None,
        on_feedback: Callable[[Feedback], None] | None = None,
        timeout_s: float = 5.0,
    ) -> ClientGoal[Goal, Result, Feedback]:
        """Send a goal, without waiting: the functions are called later as handlers.

        `on_result` gets the final status, one of the constants of `action_msgs/msg/GoalStatus`, and
        the result. `on_failure` is called in its place, with the reason, if the server rejects the
        goal, does not answer within the time limit, or ends; without it, the reason is logged as a
        warning. Raises `CairnError` if the goal is of another type than the port's, or on a
        declaration.
        """
        self._bound_name()
        if not isinstance(goal, self.interface.Goal):
            raise CairnError(
                f"{self._context.name}: port {self.name} sends goals of "
                f"{type_name(self.interface)}, not {type_of(goal)}"
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

    def services(self) -> dict[str, Client[Any, Any]]:
        """Return new ports for its three services, by their names below that of the action."""
        return {
            part: Client[Any, Any](optional=self.optional).declare(f"{self.name}/{part}", service)
            for part, service in _services(self.interface).items()
        }

    def topics(self) -> dict[str, In[Any]]:
        """Return a new port for the feedback, by its name below that of the action."""
        feedback = In[Any](optional=True)
        return {
            FEEDBACK: feedback.declare(f"{self.name}/{FEEDBACK}", self.interface.FeedbackMessage)
        }

    def bind(self, context: ComponentContext, action: str) -> None:
        """Bind the port to an action (full name)."""
        self._bind(context, action)
        services = self.services()
        for part, client in services.items():
            client.bind(context, f"{action}/{part}")
        self.clients = list(services.values())
        self._send_goal = services[SEND_GOAL]
        self._goals: GoalClient[Goal, Result, Feedback] = GoalClient(
            action,
            self.interface,
            *(partial(_call, services[part]) for part in (SEND_GOAL, CANCEL_GOAL, GET_RESULT)),
        )
        self.feedback = self.topics()[FEEDBACK]
        self.feedback.bind(
            context, f"{action}/{FEEDBACK}", [("feedback", self._goals.receive_feedback)]
        )
        # Of its own, so that goals do not change the component's other random numbers; another one
        # after a restart, because a server rejects a goal whose id it knows.
        launch = context.launch
        seed = [launch.context.seed, zlib.crc32(action.encode()), launch.incarnation]
        self._identities = np.random.default_rng([*seed, zlib.crc32(context.name.encode())])

    def _log_failure(self, error: ServiceError) -> None:
        self._context.log.warning("a goal has failed: %s", error)


def _services(action: type[Action[Any, Any, Any]]) -> dict[str, type[Service[Any, Any]]]:
    return {SEND_GOAL: action.SendGoal, CANCEL_GOAL: CancelGoal, GET_RESULT: action.GetResult}


def _call(
    client: Client[Any, Any],
    request: Any,
    on_reply: OnReply,
    on_failure: OnFailure,
    timeout_s: float,
) -> None:
    client.call(request, on_reply, on_failure, timeout_s=timeout_s)


def _ignore() -> None:
    """Do nothing when a goal is accepted."""
