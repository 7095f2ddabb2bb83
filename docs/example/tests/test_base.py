"""The base moves on command and stops without."""

import pytest
from cairn import SECOND
from cairn.runtime.lifecycle import State
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.testing.stage import Stage

from turtle_robot.base import TurtleBase
from turtle_robot.messages import BaseState

AHEAD = Twist(linear=Vector3(x=0.5))


def test_it_moves_on_command() -> None:
    stage = Stage(TurtleBase)
    for _ in range(10):
        stage.give("cmd_vel", AHEAD)
        stage.wait(0.1)

    assert stage.taken("odom")[-1].pose.pose.position.x == pytest.approx(0.5, abs=0.1)


def test_it_stops_when_commands_cease_to_come() -> None:
    stage = Stage(TurtleBase, command_timeout_s=0.3)
    stage.give("cmd_vel", AHEAD)
    stage.wait(1.0)

    speeds = [odom.twist.twist.linear.x for odom in stage.taken("odom")]

    assert speeds[0] == 0.5
    assert speeds[-1] == 0.0


def test_the_wall_stops_it() -> None:
    stage = Stage(TurtleBase, pen_m=0.3)
    stage.give("cmd_vel", AHEAD)
    stage.wait(0.5)

    state: BaseState = stage.taken("base_state")[-1]

    assert state.blocked


def test_a_jam_is_mended_in_place_but_not_for_ever() -> None:
    stage = Stage(TurtleBase, jams_per_m=10.0)
    while stage.end is None and stage.executor.now() < 60 * SECOND:
        stage.give("cmd_vel", AHEAD)
        stage.wait(0.1)

    # It recovers three times within ten seconds; the next jam is for its supervisor.
    assert stage.end is not None
    assert stage.end.reason == "move: the left wheel has jammed"
    assert stage.runtime.state is State.FINALIZED
