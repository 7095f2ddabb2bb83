"""Zones in the whole system: the robot obeys a change within a second while it drives."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from cairn.planar.polygons import distance_to_edges, is_inside
from cairn.planar.zones import zone_edges, zone_of
from cairn.schemas.cairn_nav_msgs import MotionStatus, NavigationStatus, ReasonCode
from tests.navigation.driving import STOPS_S, LockstepRobot
from tests.zone_features import area, lane

RobotFactory = Callable[..., LockstepRobot]

RADIUS = 0.22
POSE_ERROR_M = 0.04  # of the localizer, by which the robot may reach over an edge
OBEYS_S = 1.0
STOP = (
    "components.mobile_supervisor.children.automove.children.path_planner.parameters"
    ".in_keepout=stop"
)


def driving(robot: LockstepRobot, goal: tuple[float, float] = (6.6, 1.4)) -> LockstepRobot:
    """Let the robot drive to a goal along y = 1.2 m, until it is 1 m on its way."""
    robot.go(*goal)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_until(lambda: robot.truth[0] > 2.0)
    return robot


def add(robot: LockstepRobot, feature: dict[str, Any]) -> None:
    robot.request("map_builder", "add_zone", feature=feature)


def depth(robot: LockstepRobot, feature: dict[str, Any]) -> float:
    """Return how far [m] the robot reaches over the edge of a zone; negative outside."""
    edges = zone_edges(zone_of(feature))
    x, y, _ = robot.truth
    apart = distance_to_edges(edges, x, y)
    return RADIUS + apart if is_inside(edges, x, y) else RADIUS - apart


def await_end_outside(robot: LockstepRobot, feature: dict[str, Any]) -> NavigationStatus:
    """Let the mission end; assert that the robot does not enter the zone meanwhile."""
    while robot.statuses[-1].state <= NavigationStatus.RECOVERING:
        robot.run_for(0.1)
        assert depth(robot, feature) < POSE_ERROR_M, str(robot)
    return robot.statuses[-1]


def test_robot_drives_around_a_keepout_zone_that_appears_on_its_path(drive: RobotFactory) -> None:
    robot, zone = driving(drive()), area("keepout", (3.4, 0.1, 4.2, 1.9))
    add(robot, zone)

    assert await_end_outside(robot, zone).state == NavigationStatus.SUCCEEDED
    assert math.dist(robot.truth[:2], (6.6, 1.4)) < 0.25
    assert robot.collisions == []


@pytest.mark.accuracy
def test_robot_just_before_a_new_keepout_zone_stops_at_its_edge_or_turns_away(
    drive: RobotFactory,
) -> None:
    robot = driving(drive())
    x = robot.truth[0]
    zone = area("keepout", (x + 0.55, 0.1, x + 1.4, 2.2))
    add(robot, zone)
    assert await_end_outside(robot, zone).state == NavigationStatus.SUCCEEDED


@pytest.mark.accuracy
def test_robot_in_a_new_keepout_zone_leaves_it_by_the_shortest_way(drive: RobotFactory) -> None:
    robot = driving(drive())
    x, y, _ = robot.truth
    zone = area("keepout", (x - 1.0, y - 2.0, x + 2.5, y + 0.5))
    add(robot, zone)
    began = robot.now

    robot.run_until(lambda: depth(robot, zone) < POSE_ERROR_M, 15.0)

    way = math.dist((x, y), robot.truth[:2])
    assert way < 1.4  # it braked, turned, and left by the upper edge
    assert robot.now - began < 12.0
    assert await_end_outside(robot, zone).state == NavigationStatus.SUCCEEDED


@pytest.mark.accuracy
def test_robot_in_a_new_keepout_zone_stops_if_configured_and_goes_on_when_it_is_gone(
    drive: RobotFactory,
) -> None:
    robot = driving(drive(STOP))
    add(robot, area("keepout", (0.5, 0.1, 5.0, 3.0), "wet floor"))

    assert robot.time_to_stand() <= max(OBEYS_S, STOPS_S)
    robot.run_for(30.0)

    assert robot.stands()
    status = robot.statuses[-1]
    assert status.reason_code == ReasonCode.IN_KEEPOUT
    assert "is in keepout zone wet floor" in status.reason
    assert status.recoveries == 0
    robot.request("map_builder", "remove_zone", name="wet floor")
    robot.assert_arrives((6.6, 1.4))


def test_robot_without_a_goal_stays_in_a_new_keepout_zone_and_reports_it(
    drive: RobotFactory,
) -> None:
    robot = driving(drive(), (2.4, 1.2))
    assert robot.await_end().state == NavigationStatus.SUCCEEDED
    add(robot, area("keepout", (0.5, 0.1, 5.0, 3.0), "wet floor"))
    assert robot.stands()
    assert robot.motions[-1].state == MotionStatus.STANDING
    assert robot.motions[-1].reason == "in keepout zone wet floor"


def test_robot_obeys_a_new_slow_zone_within_a_second(drive: RobotFactory) -> None:
    robot = driving(drive())
    assert robot.motions[-1].speed > 0.5
    add(robot, area("slow", (0.1, 0.1, 8.9, 6.9), speed=0.2))
    robot.run_for(OBEYS_S)
    x, y, _ = robot.truth
    robot.run_for(3.0)
    assert 0.5 < math.dist((x, y), robot.truth[:2]) / 3.0 / 0.2 < 1.05
    assert robot.collisions == []


def test_goal_under_a_new_keepout_zone_fails_within_a_second(drive: RobotFactory) -> None:
    robot = driving(drive())
    add(robot, area("keepout", (6.0, 1.0, 7.0, 2.0), "wet floor"))

    end = robot.await_end(OBEYS_S)

    assert end.state == NavigationStatus.FAILED
    assert end.reason_code == ReasonCode.GOAL_IN_KEEPOUT
    assert "(6.60, 1.40) is in keepout zone wet floor; the nearest reachable" in end.reason
    assert robot.time_to_stand() <= STOPS_S
    robot.go(6.6, 1.4)
    assert robot.await_end(20.0).reason_code == ReasonCode.GOAL_IN_KEEPOUT


@pytest.mark.accuracy
def test_robot_takes_a_preferred_lane(drive: RobotFactory) -> None:
    robot = drive()
    robot.run_for(3.0)
    aisle = lane((2.9, 2.0), (6.2, 2.0), width=0.5)
    add(robot, aisle)
    robot.go(6.6, 1.4)
    robot.run_until(lambda: robot.truth[0] > 4.5)
    assert robot.truth[1] > 1.7
    robot.assert_arrives((6.6, 1.4))
