"""People walk along their waypoints and never step on the robot or into walls and furniture."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.simulation.people import Walker
from cairn.components.simulation.ray_casting import clearance
from cairn.components.simulation.world_file import Person

OPEN, NO_PEOPLE = np.zeros((0, 4)), np.zeros((0, 3))
STEP = 0.02
RADIUS = 0.22


def walker(*waypoints: tuple[float, float], **more: float) -> Walker:
    return Walker.of(Person(name="ada", waypoints=list(waypoints), **more))


def walked(
    one: Walker, seconds: float, robot: tuple[float, float], segments: np.ndarray = OPEN
) -> np.ndarray:
    positions = []
    for _ in range(round(seconds / STEP)):
        one.step(STEP, robot, RADIUS, segments)
        positions.append((one.x, one.y))
    return np.array(positions)


def test_people_walk_along_waypoints_at_their_speed_and_pause() -> None:
    positions = walked(walker((0, 0), (2, 0), (2, 1), speed=1.0, pause=0.5), 9.0, (9, 9))

    steps = np.hypot(*np.diff(positions, axis=0).T)
    assert steps.max() <= STEP + 1e-9
    for corner in [(2, 0), (2, 1), (0, 0)]:
        at = np.sum(np.hypot(*(positions - corner).T) < 1e-9)
        assert at * STEP >= 0.5 - STEP


def least_gap(one: Walker, walk: np.ndarray, robot: tuple[float, float]) -> float:
    return float(np.hypot(*(walk - robot).T).min()) - RADIUS - one.person.radius


def corridor(half: float, end: float = 9.0) -> np.ndarray:
    return np.array([[-9.0, -half, end, -half], [-9.0, half, end, half], [end, -half, end, half]])


def test_people_stop_for_the_robot_and_then_walk_around_it_if_there_is_room() -> None:
    one = walker((0, 0), (6, 0), speed=1.0)

    stops = walked(one, 5.0, (3.0, 0.0))
    assert 0.5 < least_gap(one, stops, (3.0, 0.0)) <= 0.6

    walk = walked(one, 5.5, (3.0, 0.0))
    assert walk[:, 0].max() == 6.0
    assert least_gap(one, walk, (3.0, 0.0)) > 0.1


def test_people_turn_back_after_a_while_if_there_is_no_room() -> None:
    one = walker((0, 0), (6, 0), speed=1.0)

    positions = walked(one, 14.0, (3.0, 0.0), corridor(0.7))

    assert 1.5 < positions[:, 0].max() < 3.0 - RADIUS - one.person.radius
    assert positions[-1, 0] < 1.9  # returning, or on its next turn


def test_person_with_one_route_steps_aside_for_the_robot() -> None:
    door = [[3.5, -2.0, 3.5, -0.45], [3.5, 0.45, 3.5, 2.0]]
    room = np.array([*door, [3.5, -2.0, 7.0, -2.0], [3.5, 2.0, 7.0, 2.0], [7.0, -2.0, 7.0, 2.0]])
    one = walker((0, 0), (5, 0), speed=1.0)
    one.x, one.y = 5.0, 0.0  # at the end, with the robot in the door

    walk = walked(one, 9.0, (4.0, 0.0), room)

    assert np.abs(walk[:, 1]).max() >= 0.5
    assert math.hypot(one.x - 4.0, one.y) > 1.0


def test_waypoint_that_the_robot_blocks_is_skipped() -> None:
    one = walker((0, 0), (3, 0), (3, 3), speed=1.0)

    walk = walked(one, 11.0, (3.0, 0.0))

    assert np.hypot(*(walk - (3.0, 3.0)).T).min() < 0.1
    assert least_gap(one, walk, (3.0, 0.0)) > 0.1


def test_person_with_one_waypoint_stays_there() -> None:
    one = walker((4.0, 1.4))

    walk = walked(one, 20.0, (4.5, 1.4))

    assert np.ptp(walk, axis=0).max() == 0.0


@pytest.mark.parametrize("robot", [(1.2, 0.0), (1.8, 0.4), (3.0, 0.0), (3.0, 0.8)])
def test_standing_robot_never_blocks_a_person_in_a_room_permanently(
    robot: tuple[float, float],
) -> None:
    walls = np.array([[-1, -1, 4, -1], [4, -1, 4, 3], [4, 3, -1, 3], [-1, 3, -1, -1]], float)
    one = walker((0, 0), (3, 0), (3, 2), (3, 0), speed=0.5, pause=3.0)

    walk = walked(one, 180.0, robot, walls)

    for begin in range(0, len(walk), len(walk) // 4):
        assert np.ptp(walk[begin : begin + len(walk) // 4], axis=0).max() > 1.0
    assert least_gap(one, walk, robot) > 0.1 - 1e-9
    assert min(clearance(x, y, walls, NO_PEOPLE)[0] for x, y in walk[::10]) >= one.person.radius


@given(
    st.lists(
        st.tuples(st.floats(-2, 2), st.floats(-2, 2)).filter(lambda p: math.hypot(*p) > 0.7),
        min_size=1,
        max_size=4,
    ),
    st.floats(0.1, 3.0),
)
@settings(max_examples=40, deadline=None)
def test_people_never_step_on_the_robot(positions: list[tuple[float, float]], speed: float) -> None:
    one = walker(*positions, speed=speed)

    walk = walked(one, 6.0, (0.0, 0.0))

    nearest = np.hypot(*walk.T).min()
    began = math.hypot(*positions[0])
    assert nearest >= min(began, RADIUS + one.person.radius)


def test_people_turn_back_before_new_furniture() -> None:
    wall = np.array([[2.0, -1.0, 2.0, 1.0]])
    one = walker((0, 0), (4, 0), speed=1.0)

    walk = walked(one, 8.0, (9, 9), wall)

    assert walk[:, 0].max() <= 2.0 - one.person.radius + 1e-9
    assert walk[-1, 0] < 1.0
