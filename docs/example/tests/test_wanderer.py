"""The wanderer goes ahead, turns at walls, and ends."""

import pytest
from cairn import ParameterRefused
from cairn.schemas.geometry_msgs import Point, Pose, PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.testing.stage import Stage

from turtle_robot.messages import BaseState
from turtle_robot.wanderer import Wanderer


def at(x: float) -> Odometry:
    return Odometry(pose=PoseWithCovariance(pose=Pose(position=Point(x=x))))


def test_it_turns_at_a_wall_and_then_goes_on() -> None:
    stage = Stage(Wanderer, turn_speed=6.0)
    stage.wait(0.45)
    assert all(command.linear.x == 0.5 for command in stage.taken("cmd_vel"))

    stage.give("base_state", BaseState(blocked=True))
    stage.wait(0.25)
    assert all(command.angular.z == 6.0 for command in stage.taken("cmd_vel"))

    stage.wait(1.0)
    assert stage.taken("cmd_vel")[-1].linear.x == 0.5


def test_it_ends_after_its_way_and_leaves_the_robot_standing() -> None:
    stage = Stage(Wanderer, distance=0.5)
    for step in range(6):
        stage.give("odom", at(0.1 * step + 0.001))
        stage.wait(0.1)

    assert stage.end is not None
    assert stage.end.normal
    assert stage.taken("cmd_vel")[-1].linear.x == 0.0


def test_a_way_that_is_behind_it_is_refused() -> None:
    stage = Stage(Wanderer)
    for step in range(10):
        stage.give("odom", at(0.1 * step))

    with pytest.raises(ParameterRefused, match=r"0\.9 m are behind the turtle already"):
        stage.runtime.set_parameters({"distance": 0.5, "speed": 1.0})

    assert stage.runtime.config.model_dump()["speed"] == 0.5
