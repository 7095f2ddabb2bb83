"""Any process is killed while the robot drives: it stops, recovers, and arrives."""

import os
import random
import signal
from collections.abc import Iterator

import pytest

from cairn.planar.poses import distance
from tests.navigation.processes import ObservedRobot, RunningGo, robot_in

pytestmark = [
    pytest.mark.xdist_group("robots in real time"),
    pytest.mark.processes,
    pytest.mark.accuracy,
]

# Part of the way around the room, without turning back: x, y [m], heading [deg]. 7 m, of which
# the robot drives about 4.5 m while processes are killed.
TOUR = [
    (3.0, 1.2, 0),
    (4.8, 1.4, 0),
    (6.5, 1.8, 45),
    (7.1, 3.5, 90),
]
AUTOMOVE = "components.mobile_supervisor.children.automove"
# Every process is killed once, some at the same moment as one that has nothing to do with it. At
# most three of one supervisor: it fails when four of its children die within 10 s. A restarted
# AutoMove counts from zero.
KILLED = [
    ("localizer", "object_recognizer"),
    ("base", "map_builder"),
    ("automove",),
    ("world", "path_planner"),
    ("range_scanner", "motion_control"),
    ("vision_supervisor",),
    ("mobile_supervisor",),
]
DISTANCES = random.Random(1)
# Each after a random distance [m] that the robot drives on when it has recovered.
KILLS = [(components, round(DISTANCES.uniform(0.0, 0.3), 2)) for components in KILLED]


class Tour:
    """A mission around the room, while one process after the other is killed."""

    def __init__(self, robot: ObservedRobot) -> None:
        self.robot = robot
        self._going: RunningGo | None = None

    def start(self) -> RunningGo:
        """Return the running mission; start it again if it is not running."""
        if self._going is None or self._going.process.poll() is not None:
            self._going = self.robot.go(*(f"{x},{y},{turn}deg" for x, y, turn in TOUR))
            self._going.await_output("driving")
        return self._going

    def passed_goals(self) -> list[bool]:
        """Return whether the robot was at each goal."""
        path = self.robot.path()
        return [any(distance(goal, pose) < 0.3 for pose in path) for goal in TOUR]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObservedRobot]:
    with robot_in(
        tmp_path_factory.mktemp("robot"),
        f"{AUTOMOVE}.children.motion_control.hang_timeout_s=2",
    ) as robot:
        yield robot


@pytest.fixture(scope="module")
def tour(robot: ObservedRobot) -> Tour:
    return Tour(robot)


@pytest.mark.parametrize(
    ("components", "driven"), KILLS, ids=["+".join(components) for components in KILLED]
)
def test_killed_process_does_not_end_the_mission(
    robot: ObservedRobot, tour: Tour, components: tuple[str, ...], driven: float
) -> None:
    going = tour.start()
    robot.await_moved(driven)
    lines = len(robot.run.lines)

    for component in components:
        robot.kill(component)

    for component in components:
        robot.run.await_line(f"child failed: {component}: killed by SIGKILL", after=lines)
        robot.run.await_line(f"child active: {component}", after=lines)
    robot.await_moved(0.25)
    assert going.process.poll() is None, f"{going}; {robot.run}"
    assert robot.collisions == []


def test_mission_ends_at_its_last_goal(robot: ObservedRobot, tour: Tour) -> None:
    going = tour.start()

    assert going.await_end() == 0, f"{going}; {robot.run}"
    assert distance(TOUR[-1], robot.pose) < 0.3
    assert all(tour.passed_goals())
    assert robot.collisions == []


def test_robot_stands_without_commands_and_continues(robot: ObservedRobot) -> None:
    lines = len(robot.run.lines)
    going = robot.go("6.6", "4.7", "150deg")
    going.await_output("driving")
    robot.await_moved(0.3)

    os.kill(robot.run.pid_of("motion_control"), signal.SIGSTOP)

    robot.await_stand()
    going.await_output("no status from motion control for")
    assert going.await_end() == 0, f"{going}; {robot.run}"
    robot.run.await_line(
        "child hung: motion_control: .* in a process that was stopped", after=lines
    )
    assert robot.collisions == []
