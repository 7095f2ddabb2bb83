"""Shortest paths, the reference for the planner, against results derived by hand."""

import math

import numpy as np
import pytest

from cairn_lab.evaluation.examiner import random_goal
from cairn_lab.evaluation.shortest_paths import ShortestPaths
from lab_tests.evaluation.examiner_harness import HALL, Box, segments_of

RADIUS = 0.22


def paths(*boxes: Box, radius: float = RADIUS) -> ShortestPaths:
    return ShortestPaths(np.array(segments_of(HALL, *boxes)), radius)


def test_path_without_obstacles_is_straight() -> None:
    assert paths((5, 4, 6, 6)).length((2, 2), (10, 2)) == pytest.approx(8.0)


@pytest.mark.parametrize("radius", [0.05, 0.22, 0.6])
def test_path_around_a_box_is_tangents_and_arcs(radius: float) -> None:
    found = paths((5, 4, 6, 6), radius=radius).length((3, 5), (8, 5))

    # On each side a tangent and an arc around the corner; between them the side of the box.
    first, second = (
        math.sqrt(across**2 + 1.0 - radius**2)
        + radius * (math.atan2(1.0, across) + math.asin(radius / math.hypot(across, 1.0)))
        for across in (2.0, 2.0)
    )
    exact = first + 1.0 + second
    assert found == pytest.approx(exact, rel=2e-3)
    assert found <= exact  # never longer than what a robot can drive


def test_path_takes_the_shorter_side() -> None:
    hall = paths((5, 1, 6, 6))

    assert hall.length((3, 5.5), (8, 5.5)) < 6.0  # over the top, not all the way down
    assert hall.length((3, 1.5), (8, 1.5)) < 6.0


def test_path_leads_through_a_gap_only_if_the_robot_fits() -> None:
    gap = ((5, 0, 6, 4), (5, 4.5, 6, 10))

    assert paths(*gap, radius=0.24).length((3, 4.25), (8, 4.25)) == pytest.approx(5.0)
    assert paths(*gap, radius=0.26).length((3, 4.25), (8, 4.25)) == math.inf


def test_no_path_leads_into_an_obstacle_or_out_of_the_world() -> None:
    hall = paths((5, 4, 7, 6))

    assert hall.length((2, 2), (6, 5)) == math.inf
    assert hall.length((2, 2), (20, 20)) == math.inf
    assert hall.length((2, 2), (0.1, 2)) == math.inf


def test_random_goals_are_reachable_and_have_clearance() -> None:
    hall = paths((5, 4, 7, 6), (0, 7, 12, 7.2))  # a box, and a wall that divides the hall
    random = np.random.default_rng(1)

    for _ in range(50):
        goal = random_goal(hall, (2.0, 2.0, 0.0), 1.5, 0.37, random)
        assert goal is not None
        x, y, _ = goal
        assert math.dist((x, y), (2.0, 2.0)) >= 1.5
        assert hall.clearance((x, y)) >= 0.37
        assert y < 7.0
    assert random_goal(hall, (2.0, 2.0, 0.0), 1.5, 4.0, random) is None
