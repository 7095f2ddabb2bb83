"""The wanderer drives ahead, turns at walls, and ends."""

import pytest
from cairn import ParameterRejected
from cairn.schemas.geometry_msgs import Point, Pose, PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.testing.lockstep import ComponentHarness

from turtle_robot.messages import BaseState
from turtle_robot.wanderer import Wanderer


def at(x: float) -> Odometry:
    return Odometry(pose=PoseWithCovariance(pose=Pose(position=Point(x=x))))


def test_wanderer_turns_at_a_wall_and_drives_on() -> None:
    wanderer = ComponentHarness(Wanderer, {"turn_speed": 6.0})
    wanderer.run_for(0.45)
    assert all(command.linear.x == 0.5 for command in wanderer.take("cmd_vel"))

    wanderer.publish("base_state", BaseState(blocked=True))
    wanderer.run_for(0.25)
    assert all(command.angular.z == 6.0 for command in wanderer.take("cmd_vel"))

    wanderer.run_for(1.0)
    assert wanderer.take("cmd_vel")[-1].linear.x == 0.5


def test_wanderer_stops_the_robot_and_ends_after_its_distance() -> None:
    wanderer = ComponentHarness(Wanderer, {"distance": 0.5})
    for step in range(6):
        wanderer.publish("odom", at(0.1 * step + 0.001))
        wanderer.run_for(0.1)

    assert wanderer.end is not None
    assert wanderer.end.normal
    assert wanderer.take("cmd_vel")[-1].linear.x == 0.0


def test_distance_already_traveled_is_rejected() -> None:
    wanderer = ComponentHarness(Wanderer)
    for step in range(10):
        wanderer.publish("odom", at(0.1 * step))

    with pytest.raises(ParameterRejected, match=r"already traveled 0\.9 m"):
        wanderer.set_parameters({"distance": 0.5, "speed": 1.0})

    assert wanderer.component.config.model_dump()["speed"] == 0.5
