"""Furniture, objects and people that change while the robot drives, and walls around it."""

from collections.abc import Callable

import pytest

from cairn.planar.poses import distance
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from tests.navigation.driving import FEW_RECOVERIES, LockstepRobot, share_occupied

pytestmark = pytest.mark.slow


RobotFactory = Callable[..., LockstepRobot]


@pytest.mark.accuracy
def test_moved_furniture_is_updated_in_the_grid_map(
    drive: RobotFactory,
) -> None:
    robot = drive()
    robot.go(1.2, 3.4)
    robot.assert_arrives((1.2, 3.4))
    assert share_occupied(robot.grid(), 2.4, 2.3) > 0.1

    robot.request("world", "move", name="box", x=2.6, y=4.6, theta=0.6)
    for goal in ((3.2, 1.6), (1.2, 5.4), (3.2, 1.6)):
        robot.go(*goal)
        robot.assert_arrives(goal)
    robot.run_for(6.0)

    grid = robot.grid()
    assert share_occupied(grid, 2.4, 2.3) == 0.0
    assert share_occupied(grid, 2.6, 4.6) > 0.1


def test_moved_object_is_updated_in_the_visual_map(drive: RobotFactory) -> None:
    robot = drive()
    maps = robot.read("visual_map", VisualMap)
    robot.go(3.0, 5.6)
    robot.assert_arrives((3.0, 5.6))

    robot.request("world", "move", name="object_3", x=6.9, y=7.0, theta=-1.5708)
    for goal in ((5.6, 5.6), (3.0, 5.6), (5.6, 5.6), (3.0, 5.6)):
        robot.go(*goal)
        robot.assert_arrives(goal)

    positions = {one.object_id: (one.x, one.y, 0.0) for one in maps.take()[-1].objects}
    assert not any(distance(one, (3.8, 7.0, 0.0)) < 0.5 for one in positions.values())
    assert any(distance(one, (6.9, 7.0, 0.0)) < 0.3 for one in positions.values()), positions


@pytest.mark.accuracy
def test_robot_waits_for_a_person_on_the_goal(drive: RobotFactory) -> None:
    robot = drive()
    robot.request("world", "person", name="guard", waypoints=[[4.0, 1.4]])
    robot.go(4.0, 1.4)
    robot.await_state(NavigationStatus.RECOVERING)
    assert "no path: the goal (4.00, 1.40)" in robot.statuses[-1].reason

    robot.request("world", "remove", name="guard")

    robot.assert_arrives((4.0, 1.4))
    assert robot.statuses[-1].recoveries > 0


@pytest.mark.accuracy
def test_robot_goes_near_an_obstacle_and_finds_it_removed(drive: RobotFactory) -> None:
    robot = drive("settings.scanner=URG-04LX")
    robot.go(1.2, 3.0)
    robot.assert_arrives((1.2, 3.0))
    robot.request("world", "remove", name="crate")

    robot.go(6.6, 5.6)

    robot.assert_arrives((6.6, 5.6))
    reasons = [status.reason for status in robot.statuses]
    assert any(reason.startswith("go near") for reason in reasons), robot


@pytest.mark.accuracy
def test_person_who_stays_on_the_goal_fails_the_mission(drive: RobotFactory) -> None:
    robot = drive(FEW_RECOVERIES)
    robot.request("world", "person", name="guard", waypoints=[[4.0, 1.4]])
    robot.go(4.0, 1.4)

    end = robot.await_end(120.0)

    assert end.state == NavigationStatus.FAILED
    assert end.reason.startswith("no path: the goal (4.00, 1.40)")
    assert "nearest reachable position" in end.reason
    assert robot.collisions == []
    assert robot.stands()


ENCLOSURE = (
    ("east", 0.7, 0.0, [0.2, 1.2]),
    ("north", 0.0, 0.75, [1.6, 0.2]),
    ("west", -0.7, 0.0, [0.2, 1.2]),
    ("south", 0.0, -0.75, [1.6, 0.2]),
)


def walled_in(robot: LockstepRobot) -> None:
    robot.go(1.2, 1.4)
    robot.assert_arrives((1.2, 1.4))
    x, y, _ = robot.truth
    for name, dx, dy, size in ENCLOSURE:
        robot.request("world", "furniture", name=name, x=x + dx, y=y + dy, size=size)


@pytest.mark.accuracy
def test_enclosed_goal_fails_with_the_nearest_position(drive: RobotFactory) -> None:
    robot = drive(FEW_RECOVERIES)
    for name, dx, dy, size in ENCLOSURE:
        robot.request("world", "furniture", name=name, x=7.0 + dx, y=3.0 + dy, size=size)

    robot.go(7.0, 3.0)
    end = robot.await_end(200.0)

    assert end.state == NavigationStatus.FAILED
    assert end.reason.startswith("no path: ")
    assert "nearest reachable position" in end.reason
    assert "recoveries" in end.reason
    assert robot.collisions == []
    assert robot.stands()


@pytest.mark.accuracy
def test_robot_drives_on_when_walls_are_removed(drive: RobotFactory) -> None:
    robot = drive()
    walled_in(robot)
    robot.go(3.0, 3.4)
    robot.await_state(NavigationStatus.RECOVERING)

    for name in ("east", "north"):
        robot.request("world", "remove", name=name)

    robot.assert_arrives((3.0, 3.4))
