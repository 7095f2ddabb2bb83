"""A person and the robot in each other's path: neither waits forever."""

from collections.abc import Callable

import pytest

from cairn.schemas.cairn_nav_msgs import NavigationStatus
from tests.navigation.driving import LockstepRobot

pytestmark = pytest.mark.slow


RobotFactory = Callable[..., LockstepRobot]


@pytest.mark.accuracy
def test_person_near_the_goal_walks_around_the_robot(drive: RobotFactory) -> None:
    robot = drive()
    corners = [[4.4, 1.6], [7.0, 1.6], [7.1, 3.4], [7.0, 1.6]]
    robot.request("world", "person", name="ada", waypoints=corners, speed=0.5, pause=4.0)

    for goal in ((6.75, 1.55), (5.5, 1.6), (6.8, 1.8), (6.8, 3.2)):
        robot.go(*goal)
        robot.assert_arrives(goal)


@pytest.mark.accuracy
def test_robot_gives_way_to_a_person_from_a_dead_end(drive: RobotFactory) -> None:
    robot = drive()
    for name, y in (("low", 1.45), ("high", 2.55)):
        robot.request("world", "furniture", name=name, x=7.9, y=y, size=[2.2, 0.2])
    waypoints = [[8.4, 2.0], [6.0, 2.0], [6.0, 4.5], [6.0, 2.0]]
    robot.request("world", "person", name="ada", waypoints=waypoints, speed=0.6, pause=16.0)

    robot.go(8.3, 2.0)
    robot.assert_arrives((8.3, 2.0))

    recoveries = [one.reason for one in robot.statuses if one.state == NavigationStatus.RECOVERING]
    assert any(reason.startswith("give way") for reason in recoveries)
