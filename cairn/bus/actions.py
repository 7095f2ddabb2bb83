"""The protocol of ROS 2 actions: goals, feedback, results and cancellation on services and topics.

The rules are those of rcl_action. Nothing here knows a bus, a clock or a thread: the ports of a
component, and the client of a script, give the functions by which goals and answers travel.

An action `/robot/spin` consists of the services `/robot/spin/_action/send_goal`, `cancel_goal` and
`get_result`, and the topics `/robot/spin/_action/feedback` and `status`.
"""

import logging
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any, Final, Generic

import numpy as np

from cairn.bus.bus import Call, OnFailure, OnReply, ServiceClient, ServiceError
from cairn.errors import CairnError, Escalate
from cairn.schemas.action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.builtin_interfaces import from_ns, to_ns
from cairn.schemas.message import Action, Feedback, Goal, InvalidMessage, Result, Service, type_name
from cairn.schemas.unique_identifier_msgs.msg import UUID
from cairn.system.clock import SECOND

SEND_GOAL: Final = "_action/send_goal"
CANCEL_GOAL: Final = "_action/cancel_goal"
GET_RESULT: Final = "_action/get_result"
FEEDBACK: Final = "_action/feedback"
STATUS: Final = "_action/status"

MOST_ACTIVE: Final = 100
"""Goals of one server that are active at a time; further ones are rejected."""

MOST_ENDED: Final = 100
"""Goals whose result is kept after their end, for clients that have not got it yet."""

MOST_WAITING: Final = 1000
"""Requests for results that wait for the end of goals; further ones are refused."""

RESULT_KEPT_S: Final = 900.0
"""How long a result is kept at most [s]."""

RESULT_OWED_S: Final = 10.0
"""For so long [s] a result is kept until a client asks for it, also if more goals end.

While `MOST_ENDED` such results have not been asked for, further goals are rejected.
"""

RESULT_TIMEOUT_S: Final = 7 * 24 * 3600.0
"""How long a client waits for a result [s]: a drive may take any time."""

_ENDED_WITH_FEEDBACK: Final = 16
"""Ended goals of a client whose last feedback, which their result has overtaken, is handed over."""

_NO_ID = bytes(16)
_TERMINAL = frozenset({GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED,
                       GoalStatus.STATUS_ABORTED})  # fmt: skip
STATUS_TEXT: Final = {
    GoalStatus.STATUS_UNKNOWN: "unknown",
    GoalStatus.STATUS_ACCEPTED: "accepted",
    GoalStatus.STATUS_EXECUTING: "executing",
    GoalStatus.STATUS_CANCELING: "canceling",
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}
"""What the numbers of `action_msgs/msg/GoalStatus` mean."""


def goal_id(uuid: UUID) -> bytes:
    """Return the 16 bytes of a goal's id."""
    return bytes(uuid.uuid)


def uuid_of(identity: bytes) -> UUID:
    """Return a goal's id as a message."""
    return UUID(uuid=np.frombuffer(identity, np.uint8))


class UnknownGoalError(ServiceError):
    """The server does not know a goal: it never got it, was restarted, or has forgotten it."""


class ServerGoal(Generic[Goal, Result, Feedback]):
    """A goal that an action server has received, until it ends it by one of the three methods."""

    def __init__(
        self, identity: bytes, goal: Goal, accepted_ns: int, server: "GoalServer[Any, Any, Any]"
    ) -> None:
        self.id = identity
        """16 bytes, chosen by the client."""
        self.goal = goal
        """What the client wants."""
        self.accepted_ns = accepted_ns
        self.status = GoalStatus.STATUS_ACCEPTED
        """One of the constants of `action_msgs/msg/GoalStatus`."""
        self._server = server

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""
        return self.status not in _TERMINAL

    @property
    def is_canceling(self) -> bool:
        """Whether it shall be canceled."""
        return self.status == GoalStatus.STATUS_CANCELING

    def publish_feedback(self, feedback: Feedback) -> None:
        """Send feedback to the client; nothing is sent after the goal's end."""
        if self.is_active:
            self._server.send_feedback(self, feedback)

    def succeed(self, result: Result) -> None:
        """End the goal with success; `CairnError` if it has ended already."""
        self._server.end(self, GoalStatus.STATUS_SUCCEEDED, result)

    def abort(self, result: Result) -> None:
        """End the goal without success; `CairnError` if it has ended already."""
        self._server.end(self, GoalStatus.STATUS_ABORTED, result)

    def canceled(self, result: Result) -> None:
        """End the goal as its client has requested; `CairnError` if it has ended already."""
        self._server.end(self, GoalStatus.STATUS_CANCELED, result)


class GoalServer(Generic[Goal, Result, Feedback]):
    """The goals of one action server, and its answers to clients."""

    def __init__(
        self,
        name: str,
        action: type[Action[Goal, Result, Feedback]],
        publish_feedback: Callable[[Any], None],
        publish_status: Callable[[GoalStatusArray], None],
        now: Callable[[], int],
        on_goal: Callable[[ServerGoal[Goal, Result, Feedback]], None],
        on_cancel: Callable[[ServerGoal[Goal, Result, Feedback]], None] | None,
        log: logging.Logger | logging.LoggerAdapter[Any],
    ) -> None:
        """Serve no goal yet.

        `now` returns the time [ns]. `on_goal` begins to pursue a goal, `on_cancel` to end it; a
        `CairnError` rejects that.
        """
        self._name = name
        self._action = action
        self._send_feedback = publish_feedback
        self._send_status = publish_status
        self._now = now
        self._on_goal = on_goal
        self._on_cancel = on_cancel
        self._log = log
        self._goals: OrderedDict[bytes, ServerGoal[Goal, Result, Feedback]] = OrderedDict()
        self._results: dict[bytes, tuple[Result, int]] = {}  # with the time of the end [ns]
        self._unread: set[bytes] = set()  # goals whose result no client has got yet
        self._waiting: dict[bytes, list[Call]] = {}

    @property
    def active(self) -> list[ServerGoal[Goal, Result, Feedback]]:
        """The goals that have not ended, in the order in which they were accepted."""
        return [goal for goal in self._goals.values() if goal.is_active]

    def restore(self, identity: bytes, goal: Goal) -> ServerGoal[Goal, Result, Feedback]:
        """Return a goal that was accepted before a restart of the server, executing again."""
        restored: ServerGoal[Goal, Result, Feedback] = ServerGoal(identity, goal, self._now(), self)
        restored.status = GoalStatus.STATUS_EXECUTING
        self._goals[identity] = restored
        self._publish_status()
        return restored

    def send_goal(self, call: Call) -> None:
        """Answer a call of `send_goal`."""
        self._forget_old()
        identity = goal_id(call.request.goal_id)
        reason = ""
        if identity in self._goals:
            reason = "a goal with this id exists already"
        elif len(self.active) >= MOST_ACTIVE:
            reason = f"{MOST_ACTIVE} goals are active already"
        elif len(self._results) >= MOST_ENDED and all(map(self._is_owed, self._results)):
            reason = f"the results of {MOST_ENDED} goals that have just ended were not asked for"
        goal: ServerGoal[Goal, Result, Feedback] = ServerGoal(
            identity, call.request.goal, self._now(), self
        )
        if not reason:
            self._goals[identity] = goal
            try:
                self._on_goal(goal)
            except (InvalidMessage, Escalate):
                raise
            except CairnError as error:
                del self._goals[identity]
                reason = str(error)
        response = self._action.SendGoal.Response
        stamp = from_ns(goal.accepted_ns)
        if reason:
            self._log.warning("action %s: rejected goal %s: %s", self._name, identity.hex(), reason)
            call.reply(response(accepted=False, stamp=stamp))
            return
        call.reply(response(accepted=True, stamp=stamp))
        if goal.status == GoalStatus.STATUS_ACCEPTED:
            goal.status = GoalStatus.STATUS_EXECUTING
        self._publish_status()

    def cancel_goal(self, call: Call) -> None:
        """Answer a call of `cancel_goal`: for one goal, all, or all accepted up to a time."""
        info = call.request.goal_info
        identity, until = goal_id(info.goal_id), to_ns(info.stamp)
        code = CancelGoal.Response.ERROR_NONE
        if identity != _NO_ID and until == 0:
            chosen = [goal for goal in (self._goals.get(identity),) if goal is not None]
            if not chosen:
                code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
            elif not chosen[0].is_active:
                code = CancelGoal.Response.ERROR_GOAL_TERMINATED
        else:
            chosen = [
                goal
                for goal in self.active
                if (identity == _NO_ID and until == 0)
                or goal.id == identity
                or (until != 0 and goal.accepted_ns <= until)
            ]
        canceling = [goal for goal in chosen if goal.is_active and self._begin_cancel(goal)]
        if chosen and not canceling and code == CancelGoal.Response.ERROR_NONE:
            code = CancelGoal.Response.ERROR_REJECTED
        infos = tuple(self._info(goal) for goal in canceling)
        call.reply(CancelGoal.Response(return_code=code, goals_canceling=infos))
        self._publish_status()

    def get_result(self, call: Call) -> None:
        """Answer a call of `get_result`, when the goal has ended."""
        self._forget_old()
        identity = goal_id(call.request.goal_id)
        goal = self._goals.get(identity)
        if goal is None:
            call.reply(self._result_response(GoalStatus.STATUS_UNKNOWN, self._action.Result()))
        elif identity in self._results:
            self._unread.discard(identity)
            call.reply(self._result_response(goal.status, self._results[identity][0]))
        elif sum(map(len, self._waiting.values())) >= MOST_WAITING:
            call.refuse(f"{self._name}: {MOST_WAITING} requests for results wait already")
        else:
            self._waiting.setdefault(identity, []).append(call)

    def close(self) -> None:
        """Abort all goals that are active; their clients learn of it."""
        for goal in self.active:
            self.end(goal, GoalStatus.STATUS_ABORTED, self._action.Result())
        self._goals.clear()
        self._results.clear()
        self._unread.clear()

    def send_feedback(self, goal: ServerGoal[Goal, Result, Feedback], feedback: Feedback) -> None:
        """Publish feedback for a goal."""
        if type(feedback) is not self._action.Feedback:
            raise CairnError(
                f"action {self._name}: feedback is a {type(feedback).__qualname__}, not a "
                f"{type_name(self._action.Feedback)}"
            )
        self._send_feedback(
            self._action.FeedbackMessage(goal_id=uuid_of(goal.id), feedback=feedback)
        )

    def end(self, goal: ServerGoal[Goal, Result, Feedback], status: int, result: Result) -> None:
        """End a goal, and answer all that wait for its result."""
        if type(result) is not self._action.Result:
            raise CairnError(
                f"action {self._name}: the result is a {type(result).__qualname__}, not a "
                f"{type_name(self._action.Result)}"
            )
        if not goal.is_active:
            raise CairnError(
                f"action {self._name}: goal {goal.id.hex()} has ended already: "
                f"{STATUS_TEXT[goal.status]}"
            )
        goal.status = status
        self._results[goal.id] = (result, self._now())
        waiting = self._waiting.pop(goal.id, ())
        if not waiting:
            self._unread.add(goal.id)
        for call in waiting:
            call.reply(self._result_response(status, result))
        self._forget_old()
        self._publish_status()

    def _begin_cancel(self, goal: ServerGoal[Goal, Result, Feedback]) -> bool:
        if self._on_cancel is None:
            return False
        if goal.is_canceling:
            return True
        before, goal.status = goal.status, GoalStatus.STATUS_CANCELING
        try:
            self._on_cancel(goal)
        except (InvalidMessage, Escalate):
            raise
        except CairnError as error:
            goal.status = before
            self._log.warning(
                "action %s: goal %s is not canceled: %s", self._name, goal.id.hex(), error
            )
            return False
        return True

    def _result_response(self, status: int, result: Any) -> Any:
        return self._action.GetResult.Response(status=status, result=result)

    def _info(self, goal: ServerGoal[Goal, Result, Feedback]) -> GoalInfo:
        return GoalInfo(goal_id=uuid_of(goal.id), stamp=from_ns(goal.accepted_ns))

    def _is_owed(self, identity: bytes) -> bool:
        """Return whether a goal has just ended, and no client has asked for its result yet."""
        age = self._now() - self._results[identity][1]
        return identity in self._unread and age < RESULT_OWED_S * SECOND

    def _forget_old(self) -> None:
        oldest = self._now() - round(RESULT_KEPT_S * SECOND)
        surplus = len(self._results) - MOST_ENDED
        for identity, (_, ended_ns) in list(self._results.items()):
            if ended_ns < oldest or (surplus > 0 and not self._is_owed(identity)):
                surplus -= 1
                del self._results[identity]
                del self._goals[identity]
                self._unread.discard(identity)

    def _publish_status(self) -> None:
        self._send_status(
            GoalStatusArray(
                status_list=tuple(
                    GoalStatus(goal_info=self._info(goal), status=goal.status)
                    for goal in self._goals.values()
                )
            )
        )


CallService = Callable[[Any, OnReply, OnFailure, float], None]
"""Calls a service: request, what gets the response, what gets a failure, time limit [s]."""


class ClientGoal(Generic[Goal, Result, Feedback]):
    """A goal that an action client has sent."""

    def __init__(self, identity: bytes, goal: Goal, client: "GoalClient[Any, Any, Any]") -> None:
        self.id = identity
        """16 bytes."""
        self.goal = goal
        """What the server shall do."""
        self._client = client

    def cancel(
        self, on_answer: Callable[[int], None] | None = None, *, timeout_s: float = 5.0
    ) -> None:
        """Request that the goal is canceled; it then ends with a result as always.

        `on_answer` gets the return code of `action_msgs/srv/CancelGoal`: 0 if the server accepts.
        """
        self._client.cancel(self, on_answer, timeout_s)


class GoalClient(Generic[Goal, Result, Feedback]):
    """The goals that one action client has sent."""

    def __init__(
        self,
        name: str,
        action: type[Action[Goal, Result, Feedback]],
        send_goal: CallService,
        cancel_goal: CallService,
        get_result: CallService,
    ) -> None:
        """Use these functions to call the three services."""
        self._name = name
        self._action = action
        self._send_goal = send_goal
        self._cancel_goal = cancel_goal
        self._get_result = get_result
        self._feedback: dict[bytes, Callable[[Feedback], None]] = {}
        self._ended: deque[bytes] = deque()

    def send(
        self,
        identity: bytes,
        goal: Goal,
        on_accepted: Callable[[], None],
        on_feedback: Callable[[Feedback], None] | None,
        on_result: Callable[[int, Result], None],
        on_failure: OnFailure,
        timeout_s: float,
    ) -> ClientGoal[Goal, Result, Feedback]:
        """Send a goal. `on_result` or `on_failure` is called once, at its end.

        The last feedback, which travels on a topic, may arrive after the result.
        """
        if on_feedback is not None:
            self._feedback[identity] = on_feedback

        def failed(error: ServiceError) -> None:
            self._feedback.pop(identity, None)
            on_failure(error)

        def answered(response: Any) -> None:
            if not response.accepted:
                failed(
                    ServiceError(
                        f"{self._name}: the server rejected the goal; its log has the reason"
                    )
                )
                return
            on_accepted()
            self.await_result(identity, on_result, failed)

        request = self._action.SendGoal.Request(goal_id=uuid_of(identity), goal=goal)
        self._send_goal(request, answered, failed, timeout_s)
        return ClientGoal(identity, goal, self)

    def await_result(
        self,
        identity: bytes,
        on_result: Callable[[int, Result], None],
        on_failure: OnFailure,
    ) -> None:
        """Wait for the end of a goal, also of one that another client has sent."""

        def ended(response: Any) -> None:
            self._end_feedback(identity)
            if response.status == GoalStatus.STATUS_UNKNOWN:
                on_failure(UnknownGoalError(f"{self._name}: the server does not know this goal"))
            else:
                on_result(response.status, response.result)

        request = self._action.GetResult.Request(goal_id=uuid_of(identity))
        self._get_result(request, ended, on_failure, RESULT_TIMEOUT_S)

    def _end_feedback(self, identity: bytes) -> None:
        """Hand over further feedback of an ended goal until some others have ended."""
        self._ended.append(identity)
        if len(self._ended) > _ENDED_WITH_FEEDBACK:
            self._feedback.pop(self._ended.popleft(), None)

    def receive_feedback(self, message: Any) -> None:
        """Hand a feedback message to whom it concerns, if it is for a goal of this client."""
        handle = self._feedback.get(goal_id(message.goal_id))
        if handle is not None:
            handle(message.feedback)

    def cancel(
        self,
        goal: ClientGoal[Goal, Result, Feedback],
        on_answer: Callable[[int], None] | None,
        timeout_s: float,
    ) -> None:
        """Request that a goal is canceled."""

        def answered(response: CancelGoal.Response) -> None:
            if on_answer is not None:
                on_answer(response.return_code)

        def failed(_: ServiceError) -> None:
            if on_answer is not None:
                on_answer(CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID)

        request = CancelGoal.Request(goal_info=GoalInfo(goal_id=uuid_of(goal.id)))
        self._cancel_goal(request, answered, failed, timeout_s)


class SentGoal(Generic[Goal, Result, Feedback]):
    """What is known of a goal that a script or a test has sent."""

    def __init__(self, identity: bytes, cancel: Callable[[Callable[[int], None]], None]) -> None:
        self.id = identity
        """16 bytes."""
        self.is_accepted = False
        self.feedback: list[Feedback] = []
        """All feedback so far, the oldest first."""
        self.status: int | None = None
        """The final status, of `action_msgs/msg/GoalStatus`; None until the goal has ended."""
        self.result: Result | None = None
        """None until the goal has ended."""
        self.error: ServiceError | None = None
        """Why the goal was rejected or lost; None otherwise."""
        self.cancel_code: int | None = None
        """The answer to `cancel`, of `action_msgs/srv/CancelGoal`; None until it has arrived."""
        self._cancel = cancel

    @property
    def has_ended(self) -> bool:
        """Whether it has a result, was rejected or is lost."""
        return self.status is not None or self.error is not None

    def cancel(self) -> None:
        """Request that it is canceled; never waits."""

        def answered(code: int) -> None:
            self.cancel_code = code

        self._cancel(answered)


class ActionCaller(Generic[Goal, Result, Feedback]):
    """The client of an action outside of a component: in a script or a test."""

    def __init__(
        self,
        name: str,
        action: type[Action[Goal, Result, Feedback]],
        client: Callable[[str, type[Service[Any, Any]]], ServiceClient],
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        """Use the action `name` (a full name).

        `client` makes a client of a service, by its full name. Have the messages on the topic
        `feedback_topic` passed to `receive_feedback`. `on_change` is called, on any thread, after
        each change of what is known of a goal.
        """
        self.feedback_topic = f"{name}/{FEEDBACK}"
        self._on_change = on_change
        self._clients = [
            client(f"{name}/{part}", service)
            for part, service in (
                (SEND_GOAL, action.SendGoal),
                (CANCEL_GOAL, CancelGoal),
                (GET_RESULT, action.GetResult),
            )
        ]
        self._goals: GoalClient[Goal, Result, Feedback] = GoalClient(
            name, action, *(client.call for client in self._clients)
        )
        self.receive_feedback = self._goals.receive_feedback

    @property
    def is_available(self) -> bool:
        """Whether there is a server, as far as this process knows."""
        return all(client.is_available for client in self._clients)

    def send(
        self, identity: bytes, goal: Goal, timeout_s: float = 5.0
    ) -> SentGoal[Goal, Result, Feedback]:
        """Send a goal with an id of 16 random bytes; never waits."""
        sent = self._known(identity, goal, timeout_s)

        def on_accepted() -> None:
            sent.is_accepted = True
            self._on_change()

        def on_feedback(feedback: Feedback) -> None:
            sent.feedback.append(feedback)
            self._on_change()

        on_result, on_failure = self._ends(sent)
        self._goals.send(identity, goal, on_accepted, on_feedback, on_result, on_failure, timeout_s)
        return sent

    def resume(self, sent: SentGoal[Goal, Result, Feedback]) -> None:
        """Wait again for the end of a goal whose server has ended, and has restored it."""
        sent.status = sent.error = None
        self._goals.await_result(sent.id, *self._ends(sent))

    def close(self) -> None:
        """Stop; goals that were sent continue."""
        for client in self._clients:
            client.close()

    def _known(
        self, identity: bytes, goal: Goal, timeout_s: float
    ) -> SentGoal[Goal, Result, Feedback]:
        def cancel(answered: Callable[[int], None]) -> None:
            def on_answer(code: int) -> None:
                answered(code)
                self._on_change()

            self._goals.cancel(ClientGoal(identity, goal, self._goals), on_answer, timeout_s)

        return SentGoal(identity, cancel)

    def _ends(
        self, sent: SentGoal[Goal, Result, Feedback]
    ) -> tuple[Callable[[int, Result], None], OnFailure]:
        def on_result(status: int, result: Result) -> None:
            sent.result = result
            sent.status = status
            self._on_change()

        def on_failure(error: ServiceError) -> None:
            sent.error = error
            self._on_change()

        return on_result, on_failure


def make_at_once(call: Callable[[], None]) -> None:
    """Make a call on the thread on which an answer has arrived: for scripts and tests."""
    call()
