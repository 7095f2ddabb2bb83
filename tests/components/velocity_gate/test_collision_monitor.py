"""The collision monitor: a robot that obeys it touches nothing, and can always leave."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.velocity_gate.collision_monitor import (
    Array,
    Footprint,
    StoppingAbility,
    allowed_share,
    convex_corners,
)
from cairn.components.velocity_gate.limiter import Velocity
from tests.sweeps import sampled

ROUND = Footprint(0.22)
SQUARE = Footprint(0.0, convex_corners(((0.2, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.2, -0.2))))
VELOCITY = st.tuples(st.floats(-0.6, 0.6), st.floats(-1.5, 1.5))
ANGLE = st.floats(-math.pi, math.pi)


def _after(points: Array, velocity: Velocity, seconds: float) -> Array:
    """Return points in the frame of a robot that has driven for some seconds."""
    speed, turn = velocity
    angle = turn * seconds
    half = np.sinc(angle / (2.0 * math.pi)) * speed * seconds
    x, y = half * math.cos(angle / 2), half * math.sin(angle / 2)
    cosine, sine = math.cos(angle), math.sin(angle)
    dx, dy = points[:, 0] - x, points[:, 1] - y
    return np.column_stack((cosine * dx + sine * dy, cosine * dy - sine * dx))


def _gap(outline: Footprint, points: Array) -> float:
    """Return the depth of the points: negative inside the outline, about their distance outside."""
    if outline.is_round:
        return float(np.min(np.hypot(points[:, 0], points[:, 1]))) - outline.radius
    corners = np.array(outline.corners)
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack((sides[:, 1], -sides[:, 0]))
    normals /= np.hypot(normals[:, 0], normals[:, 1])[:, None]
    return float(np.min(np.max(points @ normals.T - np.sum(normals * corners, axis=1), axis=1)))


@pytest.mark.parametrize("outline", sampled([SQUARE, ROUND]))
@given(velocity=VELOCITY, distance=st.floats(0.4, 2.0), angle=ANGLE)
@settings(max_examples=150)
def test_contact_is_when_the_outline_first_reaches_a_point(
    outline: Footprint, velocity: Velocity, distance: float, angle: float
) -> None:
    point = np.array([[distance * math.cos(angle), distance * math.sin(angle)]])
    contact_s = outline.seconds_to_contact(point, velocity)
    until = min(contact_s, 4.0)
    for seconds in np.linspace(0.0, until, 80):
        assert _gap(outline, _after(point, velocity, float(seconds))) > -2e-3
    if contact_s < 4.0:
        assert abs(_gap(outline, _after(point, velocity, contact_s))) < 2e-3


@pytest.mark.parametrize("outline", [ROUND, SQUARE])
@given(distance=st.floats(0.01, 0.19), angle=ANGLE)
def test_motion_away_from_a_point_inside_is_allowed(
    outline: Footprint, distance: float, angle: float
) -> None:
    point = np.array([[distance * math.cos(angle), distance * math.sin(angle)]])
    ways = [outline.seconds_to_contact(point, (speed, 0.0)) for speed in (0.3, -0.3)]
    assert max(ways) > 0.0


@given(velocity=VELOCITY, seconds=st.floats(0.0, 5.0), reaction_s=st.floats(0.0, 0.4))
def test_allowed_speed_stops_before_the_contact(
    velocity: Velocity, seconds: float, reaction_s: float
) -> None:
    ability = StoppingAbility(0.7, 2.0)
    share = allowed_share(seconds, velocity, ability, reaction_s, turns=False)
    speed = abs(velocity[0]) * share
    needed = speed * reaction_s + speed**2 / (2.0 * ability.braking)
    assert 0.0 <= share <= 1.0
    if velocity[0]:
        assert needed <= seconds * abs(velocity[0]) + 1e-9


@pytest.mark.parametrize(
    ("corners", "problem"),
    [
        (((0.1, 0.1), (0.1, -0.1)), "at least 3"),
        (((1.0, 0.0), (1.5, 0.5), (1.0, 1.0)), "not inside"),
        (((0.3, 0.3), (0.05, 0.0), (0.3, -0.3), (-0.3, -0.3), (-0.3, 0.3)), "not convex"),
    ],
)
def test_unusable_footprints_are_rejected(
    corners: tuple[tuple[float, float], ...], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        convex_corners(corners)
