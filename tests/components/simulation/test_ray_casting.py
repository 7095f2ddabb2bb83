"""Rays and clearances agree with a direct computation."""

import math

import numpy as np
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from cairn.components.simulation.ray_casting import NOTHING, cast, clearance

COORDINATE = st.floats(-8, 8).map(lambda value: round(value, 2))
SEGMENTS = arrays.arrays(np.float64, st.tuples(st.integers(0, 6), st.just(4)), elements=COORDINATE)
CIRCLES = st.lists(
    st.tuples(COORDINATE, COORDINATE, st.floats(0.1, 2).map(lambda value: round(value, 2))),
    max_size=3,
).map(lambda rows: np.array(rows, np.float64).reshape(-1, 3))
REACH = 10.0


def one_ray(
    x: float, y: float, angle: float, segments: np.ndarray, circles: np.ndarray
) -> tuple[float, int]:
    ranges, hit = cast(
        np.array([[x, y]], float), np.array([angle], float), segments, circles, REACH
    )
    return float(ranges[0]), int(hit[0])


def reference(x: float, y: float, angle: float, segments: np.ndarray, circles: np.ndarray) -> float:
    """The range by plane geometry."""
    start = shapely.Point(x, y)
    tip = (x + REACH * math.cos(angle), y + REACH * math.sin(angle))
    ray = shapely.LineString([(x, y), tip])
    things: list[shapely.Geometry] = []
    things += [shapely.LineString(row.reshape(2, 2)) for row in segments]
    things += [shapely.Point(row[:2]).buffer(row[2], quad_segs=256) for row in circles]
    met = [ray.intersection(thing) for thing in things]
    return min((start.distance(piece) for piece in met if not piece.is_empty), default=math.inf)


@given(COORDINATE, COORDINATE, st.floats(-3.14, 3.14), SEGMENTS, CIRCLES)
@settings(max_examples=150, deadline=None)
def test_ray_ends_at_the_first_thing_that_it_hits(
    x: float, y: float, angle: float, segments: np.ndarray, circles: np.ndarray
) -> None:
    expected, less, more = (
        reference(x, y, angle + turn, segments, circles) for turn in (0.0, -1e-3, 1e-3)
    )
    # Skip cases in which rounding decides what is hit.
    assume(math.isinf(less) == math.isinf(more) == math.isinf(expected))
    assume(
        expected > 0.0
        and (math.isinf(expected) or max(abs(less - expected), abs(more - expected)) < 0.05)
    )

    found, what = one_ray(x, y, angle, segments, circles)

    # A ray that grazes an end may hit it or what is behind, as a ray at a slightly other angle.
    nearest, farthest = min(less, expected, more), max(less, expected, more)
    assert nearest - 2e-3 <= found <= farthest + 2e-3
    assert (what == NOTHING) == math.isinf(expected)


@given(COORDINATE, COORDINATE, SEGMENTS)
@settings(max_examples=100, deadline=None)
def test_clearance_is_the_distance_to_the_nearest_segment(
    x: float, y: float, segments: np.ndarray
) -> None:
    found, what = clearance(x, y, segments, np.zeros((0, 3)))

    apart = [
        shapely.LineString(row.reshape(2, 2)).distance(shapely.Point(x, y)) for row in segments
    ]
    if apart:
        assert math.isclose(found, min(apart), abs_tol=1e-9)
        assert math.isclose(apart[what], min(apart), abs_tol=1e-9)
    else:
        assert (found, what) == (math.inf, NOTHING)


def test_person_is_hit_before_the_wall_behind() -> None:
    wall, person = np.array([[5.0, -1.0, 5.0, 1.0]]), np.array([[3.0, 0.0, 0.25]])

    assert one_ray(0, 0, 0, wall, person) == (2.75, 1)
    assert one_ray(0, 0, math.pi, wall, person) == (math.inf, NOTHING)
    assert clearance(0, 0, wall, person) == (2.75, 1)
    assert clearance(3, 0, wall, person) == (-0.25, 1)
