"""The yardstick of ways is what a taut string would be, worked out by hand."""

import math

import numpy as np
import pytest

from cairn.tools.evaluation.free_goals import free_goal
from cairn.tools.evaluation.shortest_ways import ShortestWays
from tests.cairn.tools.evaluation.examination import HALL, Corners, segments_of

RADIUS = 0.22


def ways(*boxes: Corners, radius: float = RADIUS) -> ShortestWays:
    return ShortestWays(np.array(segments_of(HALL, *boxes)), radius)


def test_where_nothing_is_between_it_is_straight() -> None:
    assert ways((5, 4, 6, 6)).length((2, 2), (10, 2)) == pytest.approx(8.0)


@pytest.mark.parametrize("radius", [0.05, 0.22, 0.6])
def test_round_a_box_it_is_a_taut_string(radius: float) -> None:
    found = ways((5, 4, 6, 6), radius=radius).length((3, 5), (8, 5))

    # On each side a tangent and an arc round the corner, between them along the box.
    one, other = (
        math.sqrt(across**2 + 1.0 - radius**2)
        + radius * (math.atan2(1.0, across) + math.asin(radius / math.hypot(across, 1.0)))
        for across in (2.0, 2.0)
    )
    exact = one + 1.0 + other
    assert found == pytest.approx(exact, rel=2e-3)
    assert found <= exact  # never longer than what a robot may drive


def test_the_shorter_side_is_chosen() -> None:
    hall = ways((5, 1, 6, 6))

    assert hall.length((3, 5.5), (8, 5.5)) < 6.0  # over the top, not all the way down
    assert hall.length((3, 1.5), (8, 1.5)) < 6.0


def test_there_is_a_way_through_a_gap_only_for_who_fits() -> None:
    gap = ((5, 0, 6, 4), (5, 4.5, 6, 10))

    assert ways(*gap, radius=0.24).length((3, 4.25), (8, 4.25)) == pytest.approx(5.0)
    assert ways(*gap, radius=0.26).length((3, 4.25), (8, 4.25)) == math.inf


def test_there_is_no_way_into_what_stands_nor_out_of_the_world() -> None:
    hall = ways((5, 4, 7, 6))

    assert hall.length((2, 2), (6, 5)) == math.inf
    assert hall.length((2, 2), (20, 20)) == math.inf
    assert hall.length((2, 2), (0.1, 2)) == math.inf


def test_goals_are_drawn_where_the_robot_has_room_and_can_get_to() -> None:
    hall = ways((5, 4, 7, 6), (0, 7, 12, 7.2))  # a box, and a wall that parts the hall
    random = np.random.default_rng(1)

    for _ in range(50):
        goal = free_goal(hall, (2.0, 2.0, 0.0), 1.5, 0.37, random)
        assert goal is not None
        x, y, _ = goal
        assert math.dist((x, y), (2.0, 2.0)) >= 1.5
        assert hall.room((x, y)) >= 0.37
        assert y < 7.0
    assert free_goal(hall, (2.0, 2.0, 0.0), 1.5, 4.0, random) is None
