"""People walk their way, and never step on a robot nor into what stands."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from components.simulation.people import Walker
from components.simulation.world_file import Person

OPEN = np.zeros((0, 4))
STEP = 0.02
RADIUS = 0.22


def walker(*waypoints: tuple[float, float], **more: float) -> Walker:
    return Walker.of(Person(name="ada", waypoints=list(waypoints), **more))


def walked(
    one: Walker, seconds: float, robot: tuple[float, float], segments: np.ndarray = OPEN
) -> np.ndarray:
    places = []
    for _ in range(round(seconds / STEP)):
        one.step(STEP, robot, RADIUS, segments)
        places.append((one.x, one.y))
    return np.array(places)


def test_they_walk_from_place_to_place_at_their_speed_and_pause() -> None:
    places = walked(walker((0, 0), (2, 0), (2, 1), speed=1.0, pause=0.5), 9.0, (9, 9))

    steps = np.hypot(*np.diff(places, axis=0).T)
    assert steps.max() <= STEP + 1e-9
    for corner in [(2, 0), (2, 1), (0, 0)]:
        at = np.sum(np.hypot(*(places - corner).T) < 1e-9)
        assert at * STEP >= 0.5 - STEP


def test_they_stop_for_a_robot_ahead_and_after_a_while_turn_round() -> None:
    one = walker((0, 0), (6, 0), speed=1.0)
    places = walked(one, 14.0, (3.0, 0.0))

    assert 1.5 < places[:, 0].max() < 3.0 - RADIUS - one.person.radius
    assert places[-1, 0] < 1.9  # on the way back or forth again


@given(
    st.lists(
        st.tuples(st.floats(-2, 2), st.floats(-2, 2)).filter(lambda p: math.hypot(*p) > 0.7),
        min_size=1,
        max_size=4,
    ),
    st.floats(0.1, 3.0),
)
@settings(max_examples=40, deadline=None)
def test_they_never_step_on_a_robot(places: list[tuple[float, float]], speed: float) -> None:
    one = walker(*places, speed=speed)

    way = walked(one, 6.0, (0.0, 0.0))

    nearest = np.hypot(*way.T).min()
    began = math.hypot(*places[0])
    assert nearest >= min(began, RADIUS + one.person.radius)


def test_what_was_put_into_their_way_turns_them_round() -> None:
    wall = np.array([[2.0, -1.0, 2.0, 1.0]])
    one = walker((0, 0), (4, 0), speed=1.0)

    way = walked(one, 8.0, (9, 9), wall)

    assert way[:, 0].max() <= 2.0 - one.person.radius + 1e-9
    assert way[-1, 0] < 1.0
