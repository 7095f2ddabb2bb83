"""Servers, clients and actions of components, in virtual time."""

from typing import Any

import numpy as np
import pytest

from cairn import (
    ActionClient,
    ActionServer,
    CairnError,
    Client,
    ClientGoal,
    Component,
    In,
    Out,
    Server,
    ServerGoal,
    ServiceError,
    cancel,
    goal,
    on,
    serve,
)
from cairn.bus.actions import MOST_ENDED, RESULT_OWED_S
from cairn.runtime.handlers import handlers_of
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.ports import services_of
from cairn.schemas.action_msgs.msg import GoalStatus, GoalStatusArray
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.std_msgs import String
from cairn.schemas.std_srvs.srv import Trigger
from cairn.schemas.unique_identifier_msgs.msg import UUID
from cairn.testing.lockstep import ComponentHarness, Lockstep
from tests.wording import assert_words


class Adder(Component):
    """Adds, but no negative numbers."""

    add: Server[AddTwoInts.Request, AddTwoInts.Response]
    result: Any = None

    @serve("add")
    def on_add(self, request: AddTwoInts.Request) -> AddTwoInts.Response:
        if request.a < 0:
            raise CairnError(f"a = {request.a}: must not be negative")
        if request.a == 13:
            raise RuntimeError("bad luck")
        return self.result or AddTwoInts.Response(sum=request.a + request.b)


class Asker(Component):
    """Adds what it reads by a service, and publishes the sum or the reason of a failure."""

    word: In[String]
    answer: Out[String]
    add: Client[AddTwoInts.Request, AddTwoInts.Response]

    @on("word")
    def ask(self, word: String) -> None:
        a, b = map(int, word.data.split())
        self.add.call(AddTwoInts.Request(a=a, b=b), self.on_sum, self.on_failure, timeout_s=2.0)

    def on_sum(self, response: AddTwoInts.Response) -> None:
        self.answer.publish(String(data=str(response.sum)))

    def on_failure(self, error: ServiceError) -> None:
        self.answer.publish(String(data=str(error)))


class Counter(Component):
    """Computes Fibonacci numbers, one per tenth of a second."""

    fibonacci: ActionServer[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]

    @goal("fibonacci")
    def begin(self, goal: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]) -> None:
        if goal.goal.order < 0:
            raise CairnError("the order is negative")
        self.numbers = [0, 1]
        self.schedule(self.clock.now(), lambda: self.step(goal))

    @cancel("fibonacci")
    def stop(self, goal: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]) -> None:
        if goal.goal.order == 77:
            raise CairnError("this one cannot be canceled")

    def step(self, goal: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]) -> None:
        result = Fibonacci.Result(sequence=self.numbers)  # type: ignore[arg-type]
        if not goal.is_active:
            return
        if goal.is_canceling:
            goal.canceled(result)
        elif len(self.numbers) > goal.goal.order:
            goal.succeed(result)
        else:
            # In the range of the type, however long it counts.
            self.numbers.append((self.numbers[-1] + self.numbers[-2]) % 1_000_000)
            goal.publish_feedback(Fibonacci.Feedback(sequence=self.numbers))  # type: ignore[arg-type]
            self.schedule(self.clock.now() + 100_000_000, lambda: self.step(goal))


class Starter(Component):
    """Sends the order that it reads as a goal, cancels it on request, and publishes its end."""

    word: In[String]
    answer: Out[String]
    fibonacci: ActionClient[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]
    sent: ClientGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]

    @on("word")
    def start(self, word: String) -> None:
        if word.data == "cancel":
            self.sent.cancel(lambda code: self.answer.publish(String(data=f"code {code}")))
            return
        self.sent = self.fibonacci.send(
            Fibonacci.Goal(order=int(word.data)),
            self.on_result,
            lambda error: self.answer.publish(String(data=str(error))),
            on_feedback=lambda one: self.answer.publish(
                String(data=f"feedback {one.sequence[-1]}")
            ),
        )

    def on_result(self, status: int, result: Fibonacci.Result) -> None:
        self.answer.publish(String(data=f"status {status}: {result.sequence.tolist()}"))


def texts(harness: ComponentHarness[Any]) -> list[str]:
    return [message.data for message in harness.take("answer")]


def test_service_of_a_component_answers() -> None:
    adder = ComponentHarness(Adder, name="adder")

    assert adder.call("add", AddTwoInts, AddTwoInts.Request(a=2, b=3)).sum == 5
    assert adder.component.add.service == "/robot/add"
    port = next(port for port in adder.runtime.status().ports if port.port == "add")
    assert (port.direction, port.messages, port.topic) == (PortStatus.SERVER, 1, "/robot/add")


def test_service_refuses_with_the_components_reason() -> None:
    adder = ComponentHarness(Adder)

    with pytest.raises(ServiceError, match="/robot/add: a = -1: must not be negative"):
        adder.call("add", AddTwoInts, AddTwoInts.Request(a=-1))
    assert adder.state is LifecycleState.ACTIVE


def test_exception_in_a_server_fails_the_component_and_the_client_learns_it() -> None:
    adder = ComponentHarness(Adder)

    with pytest.raises(ServiceError, match="its server failed"):
        adder.call("add", AddTwoInts, AddTwoInts.Request(a=13))
    assert adder.end is not None
    assert_words(adder.end.reason, "on_add (service add): RuntimeError: bad luck")


def test_response_of_another_type_fails_the_component() -> None:
    adder = ComponentHarness(Adder)
    adder.component.result = Trigger.Response()

    with pytest.raises(ServiceError):
        adder.call("add", AddTwoInts, AddTwoInts.Request())
    assert adder.end is not None
    assert_words(adder.end.reason, "service /robot/add", "example_interfaces/srv/AddTwoInts")


def test_inactive_component_serves_nothing() -> None:
    adder = ComponentHarness(Adder)
    adder.request("deactivate")

    with pytest.raises(ServiceError, match="there is no server of this type"):
        adder.call("add", AddTwoInts, AddTwoInts.Request())
    adder.request("activate")
    assert adder.call("add", AddTwoInts, AddTwoInts.Request(a=1)).sum == 1


def test_components_call_each_other() -> None:
    asker = ComponentHarness(Asker, name="asker")
    asker.publish("word", String(data="1 2"))
    assert_words(texts(asker)[0], "/robot/add: there is no server")
    assert not asker.component.add.is_available

    adder = ComponentHarness(Adder, name="adder", beside=asker)
    assert asker.component.add.is_available
    asker.publish("word", String(data="1 2"), String(data="-1 2"))
    assert texts(asker) == ["3", "/robot/add: a = -1: must not be negative"]
    adder.request("shutdown")


def test_call_that_is_not_answered_times_out() -> None:
    lockstep = Lockstep()
    lockstep.node.serve("/robot/add", AddTwoInts, lambda: None)
    asker = ComponentHarness(Asker, beside=lockstep)
    asker.publish("word", String(data="1 2"))
    asker.run_for(1.9)
    assert texts(asker) == []
    asker.run_for(0.2)
    assert texts(asker) == ["/robot/add: no answer within 2 s"]


def test_request_of_another_type_is_an_error_of_the_component() -> None:
    asker = ComponentHarness(Asker)
    with pytest.raises(CairnError, match="AddTwoInts, whose request is not std_srvs/srv/Trigger_R"):
        asker.component.add.call(Trigger.Request(), asker.component.on_sum)  # type: ignore[arg-type]


def test_action_succeeds_with_feedback_and_result() -> None:
    counter = ComponentHarness(Counter)
    status = counter.read("fibonacci/_action/status", GoalStatusArray)

    sent = counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=5))
    counter.run_until(lambda: sent.has_ended)

    assert sent.is_accepted
    assert sent.status == GoalStatus.STATUS_SUCCEEDED
    assert sent.result is not None
    assert sent.result.sequence.tolist() == [0, 1, 1, 2, 3, 5]
    assert [one.sequence[-1] for one in sent.feedback] == [1, 2, 3, 5]
    statuses = [one.status_list[0].status for one in status.messages]
    assert (statuses[0], statuses[-1]) == (2, 4)
    assert counter.component.fibonacci.goals == []


def test_goal_is_rejected_with_the_reason_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    counter = ComponentHarness(Counter)
    sent = counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=-1))

    assert_words(str(sent.error), "/robot/fibonacci", "rejected")
    assert_words(caplog.text, "action /robot/fibonacci: rejected goal", "the order is negative")


def test_goal_is_canceled() -> None:
    counter = ComponentHarness(Counter)
    sent = counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=50))
    counter.run_for(0.25)
    sent.cancel()
    counter.run_until(lambda: sent.has_ended)

    assert sent.cancel_code == CancelGoal.Response.ERROR_NONE
    assert sent.status == GoalStatus.STATUS_CANCELED
    assert sent.result is not None
    assert sent.result.sequence.tolist() == [0, 1, 1, 2, 3]
    sent.cancel()
    counter.run_for(0.0)
    assert sent.cancel_code == CancelGoal.Response.ERROR_GOAL_TERMINATED


def test_server_may_refuse_to_cancel() -> None:
    counter = ComponentHarness(Counter)
    sent = counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=77))
    sent.cancel()
    counter.run_for(0.5)
    assert sent.cancel_code == CancelGoal.Response.ERROR_REJECTED
    assert not sent.has_ended


def test_goals_are_aborted_when_their_server_becomes_inactive() -> None:
    counter = ComponentHarness(Counter)
    sent = counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=50))
    counter.run_for(0.3)
    counter.request("deactivate")
    assert sent.status == GoalStatus.STATUS_ABORTED


def test_restored_goal_answers_its_client() -> None:
    counter = ComponentHarness(Counter)
    restored = counter.component.fibonacci.restore(bytes(range(16)), Fibonacci.Goal(order=3))
    assert [one.id for one in counter.component.fibonacci.goals] == [bytes(range(16))]

    answers: list[Any] = []
    client = counter.node.client(
        "/robot/fibonacci/_action/get_result", Fibonacci.GetResult, lambda call: call()
    )
    uuid = UUID(uuid=list(range(16)))  # type: ignore[arg-type]
    request = Fibonacci.GetResult.Request(goal_id=uuid)
    client.call(request, answers.append, answers.append, 5.0)
    counter.run_for(0.0)
    restored.succeed(Fibonacci.Result(sequence=[1]))  # type: ignore[arg-type]
    counter.run_for(0.0)
    assert [(one.status, one.result.sequence.tolist()) for one in answers] == [(4, [1])]


def test_result_of_an_unknown_goal_has_status_unknown() -> None:
    counter = ComponentHarness(Counter)
    response = counter.call(
        "fibonacci/_action/get_result", Fibonacci.GetResult, Fibonacci.GetResult.Request()
    )
    assert response.status == GoalStatus.STATUS_UNKNOWN


def test_component_uses_an_action() -> None:
    starter = ComponentHarness(Starter, name="starter")
    starter.publish("word", String(data="3"))
    assert_words(texts(starter)[0], "there is no server")

    ComponentHarness(Counter, name="counter", beside=starter)
    starter.publish("word", String(data="3"))
    starter.run_for(1.0)
    assert texts(starter) == ["feedback 1", "feedback 2", "status 4: [0, 1, 1, 2]"]

    starter.publish("word", String(data="40"))
    starter.publish("word", String(data="cancel"))
    starter.run_for(1.0)
    assert texts(starter) == ["feedback 1", "code 0", "status 5: [0, 1, 1]"]


def test_goals_beyond_the_limit_are_rejected_and_leave_the_server_working() -> None:
    counter = ComponentHarness(Counter)
    sent = [counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=2)) for _ in range(300)]
    assert sum(one.error is not None for one in sent) == 200
    counter.run_for(1.0)
    assert all(one.has_ended for one in sent)
    last = counter.send_goal("fibonacci", Fibonacci, Fibonacci.Goal(order=2))
    counter.run_until(lambda: last.has_ended)
    assert last.status == GoalStatus.STATUS_SUCCEEDED


def test_results_that_were_not_asked_for_are_kept_and_delay_further_goals() -> None:
    counter = ComponentHarness(Counter)

    def is_accepted(number: int) -> bool:
        request = Fibonacci.SendGoal.Request(goal_id=uuid(number))
        response = counter.call("fibonacci/_action/send_goal", Fibonacci.SendGoal, request)
        return response.accepted

    def status(number: int) -> int:
        request = Fibonacci.GetResult.Request(goal_id=uuid(number))
        service = "fibonacci/_action/get_result"
        return counter.call(service, Fibonacci.GetResult, request).status

    accepted = [is_accepted(number) for number in range(MOST_ENDED + 50)]
    assert accepted == [True] * MOST_ENDED + [False] * 50

    assert status(0) == GoalStatus.STATUS_SUCCEEDED
    assert is_accepted(200)
    assert [status(one) for one in (0, 1)] == [
        GoalStatus.STATUS_UNKNOWN, GoalStatus.STATUS_SUCCEEDED,
    ]  # fmt: skip

    counter.run_for(RESULT_OWED_S)
    assert all(is_accepted(number) for number in range(300, 350))


def uuid(number: int) -> UUID:
    return UUID(uuid=np.frombuffer(number.to_bytes(16, "big"), np.uint8))


@pytest.mark.parametrize(
    ("annotation", "words"),
    [
        (Server, "no service type"),
        (Server[Trigger.Request, AddTwoInts.Response], "no service type"),
        (Client[String, String], "no service type"),
        (ActionServer[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Result], "no action type"),
    ],
)
def test_wrong_service_types_are_rejected(annotation: Any, words: str) -> None:
    cls = type("Odd", (), {"__annotations__": {"port": annotation}})
    with pytest.raises(CairnError, match=words):
        handlers_of(cls)


def test_server_needs_exactly_one_method() -> None:
    cls = type("Silent", (), {"__annotations__": {"add": services_annotation()}})
    with pytest.raises(CairnError, match='add: 0 methods are decorated @serve\\("add"\\)'):
        handlers_of(cls)
    assert services_of(cls)["add"].interface is AddTwoInts


def services_annotation() -> Any:
    return Server[AddTwoInts.Request, AddTwoInts.Response]
