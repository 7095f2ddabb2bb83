"""The rules of actions, without a bus."""

from collections.abc import Callable
from typing import Any

import numpy as np

from cairn.bus.actions import GoalClient, uuid_of
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.example_interfaces.action import Fibonacci


class _Service:
    """Stands for a service of the action: answers are given by the test."""

    def __init__(self) -> None:
        self.answers: list[Callable[[Any], None]] = []

    def __call__(self, request: Any, answer: Any, failure: Any, timeout_s: float) -> None:
        del request, failure, timeout_s
        self.answers.append(answer)


def test_feedback_that_its_result_has_overtaken_is_handed_over() -> None:
    send, cancel, get_result = _Service(), _Service(), _Service()
    client = GoalClient("/robot/fibonacci", Fibonacci, send, cancel, get_result)
    received: list[tuple[int, int]] = []
    goals = 100

    def feedback(number: int, value: int) -> Any:
        content = Fibonacci.Feedback(sequence=np.array([value], np.int32))
        identity = uuid_of(bytes([number] * 16))
        return Fibonacci.FeedbackMessage(goal_id=identity, feedback=content)

    def noting(number: int) -> Callable[[Any], None]:
        return lambda one: received.append((number, int(one.sequence[0])))

    for number in range(1, goals + 1):
        client.send(
            bytes([number] * 16),
            Fibonacci.Goal(order=3),
            lambda: None,
            noting(number),
            lambda status, result: None,
            lambda error: None,
            5.0,
        )
        send.answers[-1](Fibonacci.SendGoal.Response(accepted=True))
        client.receive_feedback(feedback(number, 1))
        get_result.answers[-1](
            Fibonacci.GetResult.Response(
                status=GoalStatus.STATUS_SUCCEEDED, result=Fibonacci.Result()
            )
        )
        client.receive_feedback(feedback(number, 2))
    assert received == [(number, value) for number in range(1, goals + 1) for value in (1, 2)]
    client.receive_feedback(feedback(1, 3))  # long ended: it is not kept for ever
    assert received[-1] == (goals, 2)
