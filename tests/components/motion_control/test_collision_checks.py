"""Collision checks: closed forms against many small steps."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.motion_control.collision_checks import (
    UNLIMITED_M,
    check_arcs,
    check_lines,
    check_straight_lines,
    free_length,
)

RADIUS, LEAST = 0.27, 0.23


def swept(points: np.ndarray, curvature: float, length: float = 0.5) -> tuple[float, float]:
    free, clear = np.empty(1), np.empty(1)
    check_arcs(points, np.array([curvature]), np.array([length]), RADIUS, LEAST, free, clear)
    return float(free[0]), float(clear[0])


def stepped(x: float, y: float, curvature: float, length: float) -> list[float]:
    """The distance of a point to the center at every millimeter of an arc."""
    way = np.arange(0.0, length, 0.001)
    if abs(curvature) < 1e-9:
        places = np.column_stack((way, np.zeros_like(way)))
    else:
        places = np.column_stack(
            (np.sin(curvature * way) / curvature, (1 - np.cos(curvature * way)) / curvature)
        )
    distances: list[float] = np.hypot(places[:, 0] - x, places[:, 1] - y).tolist()
    return distances


@settings(max_examples=300, deadline=None, derandomize=True)
@given(x=st.floats(-2, 2), y=st.floats(-2, 2), curvature=st.floats(-5, 5))
def test_free_length_of_arcs_equals_that_of_many_small_steps(
    x: float, y: float, curvature: float
) -> None:
    curvature = 0.0 if abs(curvature) < 0.01 else curvature
    if math.hypot(x, y) <= RADIUS:
        return

    free, clear = swept(np.array([[x, y]]), curvature)

    length = 2.5 if curvature == 0.0 else min(2.5, 2 * math.pi / abs(curvature))
    distances = stepped(x, y, curvature, length)
    touched = next((k * 0.001 for k, d in enumerate(distances) if d < RADIUS), math.inf)
    if touched < math.inf:
        assert free == pytest.approx(touched, abs=0.01)
    else:
        assert free > length - 0.02 or min(distances) < RADIUS + 0.001
    assert clear == pytest.approx(min(distances[:500]), abs=0.002)


def test_arcs_without_points_are_free() -> None:
    free, clear = swept(np.empty((0, 2)), 0.5)

    assert (free, clear) == (UNLIMITED_M, UNLIMITED_M)


def test_point_in_the_margin_must_not_come_nearer() -> None:
    beside = np.array([[0.0, 0.25]])
    ahead = np.array([[0.25, 0.0]])

    assert swept(beside, 0.0)[0] == UNLIMITED_M
    assert swept(np.array([[0.1, 0.23]]), 0.0)[0] < 0.02
    assert swept(np.array([[-0.1, 0.23]]), 0.0)[0] == UNLIMITED_M
    assert swept(ahead, 0.0)[0] < 0.01
    assert swept(-ahead, 0.0)[0] == UNLIMITED_M


def test_point_inside_the_robot_blocks_motions_toward_it_only() -> None:
    ahead, behind = np.array([[0.05, 0.2]]), np.array([[-0.05, 0.2]])

    assert swept(ahead, 0.0)[0] == 0.0
    assert swept(behind, 0.0)[0] == UNLIMITED_M


def test_lines_are_free_up_to_points() -> None:
    free = np.empty(4)
    directions = np.array([0.0, math.pi / 2, math.pi, -math.pi / 2])

    check_lines(np.array([[1.0, 0.0], [0.0, -2.0]]), directions, RADIUS, LEAST, free)

    assert free == pytest.approx([1 - RADIUS, UNLIMITED_M, UNLIMITED_M, 2 - RADIUS])


def test_path_is_free_up_to_an_obstacle() -> None:
    way = np.column_stack((np.arange(0, 1, 0.05), np.zeros(20)))

    assert free_length(np.array([[0.8, 0.0]]), way, 0.05, RADIUS) == pytest.approx(0.55)
    assert free_length(np.array([[0.8, 0.3]]), way, 0.05, RADIUS) == UNLIMITED_M
    assert free_length(np.array([[0.0, 0.2]]), way, 0.05, RADIUS) == UNLIMITED_M


def test_straight_lines_past_obstacles_are_found() -> None:
    free = np.empty(2, np.bool_)

    check_straight_lines(
        np.array([[0.5, 0.0]]), np.array([[0.0, 0.0], [0.0, 1.0]]), 1.0, 0.5, RADIUS, free
    )

    assert free.tolist() == [False, True]
