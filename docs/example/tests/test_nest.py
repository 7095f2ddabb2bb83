"""The nest keeps a turtle until it is charged, and is not closed above it."""

from typing import Any

import pytest
from cairn import ServiceError
from cairn.bus.actions import SentGoal
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.nav2_msgs.action import DockRobot
from cairn.schemas.std_srvs.srv import SetBool
from cairn.testing.lockstep import ComponentHarness

from turtle_robot.messages import BaseState
from turtle_robot.nest import Nest


def dock(nest: ComponentHarness[Nest]) -> SentGoal[Any, Any, Any]:
    sent = nest.send_goal("dock", DockRobot, DockRobot.Goal())
    nest.run_for(0.1)
    return sent


def test_turtle_stays_until_it_is_charged() -> None:
    nest = ComponentHarness(Nest)
    sent = dock(nest)
    nest.publish("base_state", BaseState(charge=0.9))
    nest.run_for(0.1)
    assert [feedback.state for feedback in sent.feedback] == [DockRobot.Feedback.WAIT_FOR_CHARGE]
    assert not sent.has_ended

    nest.publish("base_state", BaseState(charge=1.0))
    nest.run_for(0.1)
    assert sent.status == GoalStatus.STATUS_SUCCEEDED
    assert sent.result.success


def test_nest_is_closed_only_without_a_turtle_and_accepts_none_then() -> None:
    nest = ComponentHarness(Nest)
    sent = dock(nest)
    with pytest.raises(ServiceError, match="a turtle is in the nest"):
        nest.call("close_nest", SetBool, SetBool.Request(data=True))

    sent.cancel()
    nest.run_for(0.1)
    assert sent.status == GoalStatus.STATUS_CANCELED
    assert nest.call("close_nest", SetBool, SetBool.Request(data=True)).success

    assert not dock(nest).is_accepted
