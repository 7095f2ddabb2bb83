"""Following paths in a small world: to the goal, at speed, and never into anything."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.motion_control.behaviors import Follow, MotionState
from cairn.planar.poses import Pose, wrap
from tests.components.motion_control.people import Walker
from tests.components.motion_control.world import (
    LIMITS,
    Array,
    Record,
    Robot,
    Wall,
    World,
    box,
    drive,
    route,
)
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = pytest.mark.slow


HALL = box(0, 0, 20, 20)
ALL_ROUND, FRONT = 2 * math.pi, 1.5 * math.pi


def follow(*points: tuple[float, float], heading: float = 0.0, within: float = 0.1) -> Follow:
    return Follow(LIMITS, route(*points, heading=heading), within, within)


def assert_reached(record: Record, goal: Pose) -> None:
    x, y, heading = record.poses[-1]
    assert record.states[-1] is MotionState.DONE
    assert record.clearance > 0.0
    assert math.hypot(x - goal[0], y - goal[1]) < 0.1
    assert abs(wrap(heading - goal[2])) < 0.1


def reversals(record: Record) -> int:
    """The number of changes of the turning direction."""
    turns = [turn for turn in record.turns if abs(turn) > 0.2]
    return sum(a * b < 0 for a, b in pairwise(turns))


def door(width: float, thickness: float = 0.1) -> list[Wall]:
    half, t = width / 2, thickness / 2
    return [
        *box(0, half + 5, 2 * t, 10),
        *box(0, -half - 5, 2 * t, 10),
    ]


def test_free_straight_path_is_driven_at_full_speed() -> None:
    record = drive(World(HALL), Robot((-5, 0, 0)), follow((-5, 0), (5, 0)), 30)

    assert_reached(record, (5, 0, 0))
    on_the_way = [v for v, (x, _, _) in zip(record.speeds, record.poses, strict=True) if -4 < x < 4]
    assert min(on_the_way) > 0.58
    assert max(record.speeds) < 0.601
    assert max(abs(y) for _, y, _ in record.poses) < 0.03
    assert record.times[-1] < 20


def test_corner_is_driven_without_stopping() -> None:
    path = follow((-3, 0), (0, 0), (0, 3), heading=math.pi)

    record = drive(World(HALL), Robot((-3, 0, 0)), path, 30)

    assert_reached(record, (0, 3, math.pi))
    near = [
        v for v, (x, y, _) in zip(record.speeds, record.poses, strict=True) if x * x + y * y < 1
    ]
    assert min(near) > 0.25


def test_walls_of_a_corridor_with_a_corner_are_kept_clear() -> None:
    walls = [(-4.0, 0.6, -0.6, 0.6), (-0.6, 0.6, -0.6, 4.0), (-4.0, -0.6, 0.6, -0.6)]
    walls += [(0.6, -0.6, 0.6, 4.0)]

    record = drive(
        World(walls), Robot((-3, 0, 0)), follow((-3, 0), (0, 0), (0, 3), heading=math.pi / 2), 30
    )

    assert_reached(record, (0, 3, math.pi / 2))
    assert record.clearance > 0.2


def test_slalom_between_boxes_is_followed() -> None:
    boxes = [wall for x in (-2, 0, 2) for wall in box(x, 0, 0.4, 0.4)]
    points = [(-4, 0), (-2.8, 0.3), (-2, 0.65), (-1.2, 0.3), (-0.8, -0.3), (0, -0.65)]
    points += [(0.8, -0.3), (1.2, 0.3), (2, 0.65), (2.8, 0.3), (4, 0)]

    record = drive(World(HALL + boxes), Robot((-4, 0, 0)), follow(*points), 40)

    assert_reached(record, (4, 0, 0))
    assert record.clearance > 0.06


def test_robot_drives_around_boxes_on_the_path() -> None:
    boxes = [wall for x in (-2, 0, 2) for wall in box(x, 0, 0.4, 0.4)]

    record = drive(World(HALL + boxes), Robot((-4, 0, 0)), follow((-4, 0), (4, 0)), 40)

    assert_reached(record, (4, 0, 0))
    assert record.clearance > 0.04
    assert MotionState.BLOCKED not in record.states


@pytest.mark.parametrize("aside", [0.0, 0.08, -0.15])
@pytest.mark.parametrize("view", [ALL_ROUND, FRONT])
def test_narrow_door_is_passed_with_a_path_beside_its_middle(aside: float, view: float) -> None:
    path = follow((-3, aside), (3, aside))

    record = drive(World(HALL + door(0.9)), Robot((-3, 0, 0)), path, 30, view=view)

    assert_reached(record, (3, aside, 0))
    assert record.clearance > 0.05
    assert reversals(record) < 8


def test_narrow_door_is_passed_at_an_angle() -> None:
    path = follow((-3, 1.5), (-0.8, 0), (0.8, 0), (3, -1.5))

    record = drive(World(HALL + door(0.9, 0.3)), Robot((-3, 1.5, 0)), path, 30)

    assert_reached(record, (3, -1.5, 0))


class Sudden(World):
    """A world to which a wall is added after 4 s."""

    def __init__(self, walls: list[Wall], later: list[Wall]) -> None:
        super().__init__(walls)
        self.first, self.then = walls, walls + later

    def ranges(self, time: float, scanner: Pose, angles: Array, noise: Array) -> Array:
        self.walls = self.then if time >= 4.0 else self.first
        return super().ranges(time, scanner, angles, noise)


@pytest.mark.parametrize("ahead", [0.6, 0.8, 1.5])
def test_robot_stops_before_a_wall_that_appears_on_the_path(ahead: float) -> None:
    at = -5 + 0.6 * 4 - 0.225 + ahead  # the robot's position by then, and a distance ahead

    record = drive(
        Sudden(HALL, [(at, -10, at, 10)]), Robot((-5, 0, 0)), follow((-5, 0), (5, 0)), 10
    )

    assert record.clearance > 0.02
    assert record.states[-1] is MotionState.BLOCKED
    assert "ahead on the path" in record.results[-1].reason
    assert record.speeds[-1] == pytest.approx(0.0, abs=1e-3)
    assert max(abs(turn) for turn in record.turns[-100:]) < 1e-3


@pytest.mark.parametrize("speed", [0.6, 1.0, 1.3])
@pytest.mark.parametrize("begin", sampled([1.0, 2.0, 3.0, 4.0]))
def test_crossing_person_is_not_touched(speed: float, begin: float) -> None:
    robot = Robot((-5, 0, 0))
    person = Walker(robot, (-2, -3), (0, speed), begin)

    record = drive(World(HALL, person), robot, follow((-5, 0), (5, 0)), 60)

    assert_reached(record, (5, 0, 0))
    assert record.clearance > 0.04


@pytest.mark.parametrize("aside", [0.0, 0.3, 0.6])
def test_approaching_person_is_not_touched(aside: float) -> None:
    robot = Robot((-5, 0, 0))
    person = Walker(robot, (4.5, aside), (-1, 0), 0.0)

    record = drive(World(HALL, person), robot, follow((-5, 0), (5, 0)), 60)

    assert_reached(record, (5, 0, 0))
    assert record.clearance > 0.04


headings = st.floats(-math.pi, math.pi)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    x=st.floats(-2.5, 2.5),
    y=st.floats(-2.5, 2.5),
    heading=headings,
    goal_heading=headings,
    seed=st.integers(0, 99),
)
def test_goal_is_reached_from_anywhere(
    x: float, y: float, heading: float, goal_heading: float, seed: int
) -> None:
    path = follow((x, y), (0.5, -0.5), heading=goal_heading)

    record = drive(World(box(0, 0, 6, 6)), Robot((x, y, heading)), path, 30, seed=seed)

    assert_reached(record, (0.5, -0.5, goal_heading))


@pytest.mark.accuracy
@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    heading=headings, away=st.floats(-3.0, -0.15), length=st.floats(1, 3), seed=st.integers(0, 9)
)
def test_robot_a_centimeter_from_a_wall_gets_away(
    heading: float, away: float, length: float, seed: int
) -> None:
    goal = length * math.cos(away), min(-0.1, length * math.sin(away))
    wall = (-10.0, 0.23, 10.0, 0.23)
    path = follow((0, 0), goal, heading=heading)

    record = drive(World([*HALL, wall]), Robot((0, 0, heading)), path, 40, seed=seed)

    assert_reached(record, (*goal, heading))


@pytest.mark.accuracy
@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), view=st.sampled_from([ALL_ROUND, FRONT, math.pi]))
def test_nothing_is_touched_among_clutter(seed: int, view: float) -> None:
    random = np.random.default_rng(seed)
    walls = box(0, 0, 12, 8)
    for _ in range(16):
        x, y, width, height = random.uniform((-4, -3, 0.1, 0.1), (4, 3, 1, 1))
        walls += box(x, y, width, height)

    record = drive(
        World(walls), Robot((-5.5, 0, 0)), follow((-5.5, 0), (5.5, 0)), 20, seed=seed, view=view
    )

    assert record.clearance > 0.0


@pytest.mark.parametrize("width", [0.7, 0.56])
def test_barely_wide_gap_is_passed_slowly(width: float) -> None:
    record = drive(World(HALL + door(width)), Robot((-3, 0, 0)), follow((-3, 0), (3, 0)), 40)

    assert_reached(record, (3, 0, 0))
    within = [v for v, (x, _, _) in zip(record.speeds, record.poses, strict=True) if abs(x) < 0.1]
    assert max(within) < (0.5 if width == 0.7 else 0.25)


def test_too_narrow_gap_is_not_tried() -> None:
    record = drive(World(HALL + door(0.48)), Robot((-3, 0, 0)), follow((-3, 0), (3, 0)), 20)

    assert record.states[-1] is MotionState.BLOCKED
    assert record.clearance > 0.03


@pytest.mark.parametrize("room", [0.07, 0.03])
def test_goal_close_to_a_wall_is_reached(room: float) -> None:
    wall = (3.0, -5.0, 3.0, 5.0)
    goal = 3.0 - 0.22 - room

    record = drive(World([*HALL, wall]), Robot((0, 0, 0)), follow((0, 0), (goal, 0)), 30)

    assert_reached(record, (goal, 0, 0))


def test_distant_path_is_not_followed() -> None:
    record = drive(World(HALL), Robot((0, 3, 0)), follow((-5, 0), (5, 0)), 3)

    assert record.states[-1] is MotionState.BLOCKED
    assert_words(record.results[-1].reason, "path", "3.0 m")


def test_robot_does_not_drive_onto_unseen_ground() -> None:
    class Blind(World):
        def ranges(self, time: float, scanner: Pose, angles: Array, noise: Array) -> Array:
            seen = super().ranges(time, scanner, angles, noise)
            return seen if time < 2.0 else np.full_like(seen, np.nan)

    record = drive(Blind(HALL), Robot((-5, 0, 0)), follow((-5, 0), (5, 0)), 10)

    assert record.speeds[-1] == pytest.approx(0.0, abs=1e-3)
    assert record.states[-1] is MotionState.BLOCKED
    assert "did not see" in record.results[-1].reason


def test_accelerations_stay_within_limits() -> None:
    record = drive(
        World(HALL), Robot((-5, 0, 2.0)), follow((-5, 0), (-2, 0), (-2, 2), heading=1.0), 30
    )

    speeds, turns = np.diff(record.speeds), np.diff(record.turns)
    assert abs(speeds).max() <= 0.8 * 0.02 + 1e-9
    assert abs(turns).max() <= 3.0 * 0.02 + 1e-9
    assert max(abs(np.array(record.turns))) < 1.501
