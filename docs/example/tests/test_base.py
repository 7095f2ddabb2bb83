"""The base moves on command and stops without commands."""

import pytest
from cairn import LifecycleState
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.testing.lockstep import ComponentHarness

from turtle_robot.base import TurtleBase
from turtle_robot.messages import BaseState

AHEAD = Twist(linear=Vector3(x=0.5))


def test_base_moves_on_command() -> None:
    base = ComponentHarness(TurtleBase)
    for _ in range(10):
        base.publish("cmd_vel", AHEAD)
        base.run_for(0.1)

    assert base.take("odom")[-1].pose.pose.position.x == pytest.approx(0.5, abs=0.1)


def test_base_stops_when_commands_cease() -> None:
    base = ComponentHarness(TurtleBase, {"command_timeout_s": 0.3})
    base.publish("cmd_vel", AHEAD)
    base.run_for(1.0)

    speeds = [odom.twist.twist.linear.x for odom in base.take("odom")]

    assert speeds[0] == 0.5
    assert speeds[-1] == 0.0


def test_wall_blocks_the_base() -> None:
    base = ComponentHarness(TurtleBase, {"pen_m": 0.3})
    base.publish("cmd_vel", AHEAD)
    base.run_for(0.4)

    state: BaseState = base.take("base_state")[-1]

    assert state.blocked


def test_base_recovers_from_jams_until_the_limit() -> None:
    base = ComponentHarness(TurtleBase, {"jams_per_m": 10.0})
    while base.end is None and base.now < 60.0:
        base.publish("cmd_vel", AHEAD)
        base.run_for(0.1)

    # It recovers three times within ten seconds; after the next jam it fails.
    assert base.end is not None
    assert base.end.reason == "move: the left wheel has jammed"
    assert base.state is LifecycleState.FINALIZED
