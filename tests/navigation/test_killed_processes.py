"""Any process is killed while the robot drives: it stops, recovers, and arrives."""

import os
import random
import signal
from collections.abc import Iterator

import pytest

from planar.poses import distance
from tests.navigation.processes import Robot, robot_in

# Once around the room, so that the robot need not turn about on its way: x, y [m], heading [deg].
TOUR = [
    (1.2, 1.2, -30),
    (3.0, 1.2, 0),
    (4.8, 1.4, 0),
    (6.5, 1.8, 45),
    (7.1, 3.5, 90),
    (6.6, 4.7, 150),
    (5.2, 5.5, 180),
    (3.4, 5.4, 180),
    (1.6, 5.2, -120),
    (1.2, 3.2, -90),
]
AUTOMOVE = "components.mobile_supervisor.children.automove"
COMPONENTS = [
    "localizer",
    "map_builder",
    "path_planner",
    "motion_control",
    "automove",
    "mobile_supervisor",
    "base",
    "range_scanner",
    "world",
    "object_recognizer",
    "vision_supervisor",
]
MOMENTS = random.Random(1)
# 20 kills, each when a share drawn at random of a leg's way is driven.
KILLS = [(COMPONENTS[n % len(COMPONENTS)], round(MOMENTS.uniform(0.0, 0.8), 2)) for n in range(20)]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with robot_in(
        tmp_path_factory.mktemp("robot"),
        f"{AUTOMOVE}.children.motion_control.hang_timeout_s=2",
    ) as robot:
        yield robot


def next_place(robot: Robot) -> tuple[float, float, float]:
    nearest = min(TOUR, key=lambda place: distance(place, robot.place))
    return TOUR[(TOUR.index(nearest) + 1) % len(TOUR)]


@pytest.mark.parametrize(("component", "driven"), KILLS)
def test_a_process_killed_on_the_way_does_not_end_the_order(
    robot: Robot, component: str, driven: float
) -> None:
    x, y, degrees = next_place(robot)
    way = distance((x, y, 0.0), robot.place)
    lines = len(robot.run.lines)
    going = robot.go(str(x), str(y), f"{degrees}deg")
    going.await_word("driving")
    robot.await_near((x, y, 0.0), way * (1.0 - driven))

    robot.kill(component)

    assert going.await_end() == 0, f"{going}; {robot.run}"
    assert distance((x, y, 0.0), robot.place) < 0.3
    assert robot.collisions == []
    robot.run.await_line(f"{component} was killed by SIGKILL", after=lines)
    robot.run.await_line(f"{component} active", after=lines)


def test_without_commands_the_robot_stands_and_goes_on_when_they_come_again(robot: Robot) -> None:
    x, y, degrees = next_place(robot)
    lines = len(robot.run.lines)
    going = robot.go(str(x), str(y), f"{degrees}deg")
    going.await_word("driving")
    robot.await_moved(0.3)

    os.kill(robot.run.pid_of("motion_control"), signal.SIGSTOP)

    robot.await_stand()
    going.await_word("nothing was heard of motion control for")
    assert going.await_end() == 0, f"{going}; {robot.run}"
    robot.run.await_line("motion_control hung in a process that was stopped", after=lines)
    assert robot.collisions == []
