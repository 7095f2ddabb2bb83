"""The likelihood field: values, frames, the map's border, and windows that change."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.localizer.likelihood_field import LikelihoodField, ScanMap
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid
from cairn.planar.poses import Pose

SIGMA, STRAY = 0.1, 0.05


def field_of(cells: list[tuple[int, int]], origin: Pose = (0.0, 0.0, 0.0)) -> LikelihoodField:
    values = np.full((40, 60), FREE, np.int8)
    for row, column in cells:
        values[row, column] = OCCUPIED
    return LikelihoodField(Grid(values, Frame(0.05, origin)), SIGMA, STRAY)


def expected(distance: float) -> float:
    return math.log(math.exp(-0.5 * (distance / SIGMA) ** 2) * (1 - STRAY) + STRAY)


def at(field: LikelihoodField, *pose: float, point: tuple[float, float] = (1.0, 0.0)) -> float:
    value = field.log_likelihood(np.array([pose]).T.copy(), np.array([point]))
    return float(value[0])


def test_deviation_uses_only_beams_near_an_obstacle() -> None:
    field = field_of([(20, 30)])
    x, y = field.frame.point(20, 30)
    points = np.array([(x, y), (x + 0.1, y), (x, y + 0.2), (x + 0.5, y)])

    assert field.deviation((0.0, 0.0, 0.0), points) == pytest.approx(
        math.sqrt((0.1**2 + 0.2**2) / 3), rel=0.01
    )
    assert math.isnan(field.deviation((0.0, 0.0, 0.0), points[3:]))


def test_beam_likelihood_depends_on_the_nearest_obstacle() -> None:
    field = field_of([(20, 30)])

    assert at(field, 0.525, 1.025, 0.0) == pytest.approx(expected(0.0), abs=1e-5)
    assert at(field, 0.425, 1.025, 0.0) == pytest.approx(expected(0.1), abs=1e-5)
    assert at(field, 0.0, 0.0, 0.0) == pytest.approx(math.log(STRAY), abs=1e-5)
    assert at(field, 1.525, 0.025, math.pi / 2) == pytest.approx(expected(0.0), abs=1e-5)


@given(
    st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3)),
    st.integers(5, 34),
    st.integers(5, 54),
)
@settings(max_examples=50)
def test_rotated_map_is_read_in_its_frame(origin: Pose, row: int, column: int) -> None:
    field = field_of([(row, column)], origin)
    x, y = Frame(0.05, origin).point(row, column)

    assert at(field, x, y, 0.3, point=(0.0, 0.0)) == pytest.approx(expected(0.0), abs=1e-4)


def test_point_off_the_map_is_not_treated_as_its_border() -> None:
    field = field_of([(row, 59) for row in range(40)])

    assert at(field, 7.0, 1.0, 0.0) == pytest.approx(math.log(STRAY), abs=1e-5)
    assert at(field, -1e6, 1e6, 0.0) == pytest.approx(math.log(STRAY), abs=1e-5)


@given(st.integers(0, 35), st.integers(0, 50), st.integers(1, 5), st.integers(1, 9))
@settings(max_examples=40)
def test_renewed_window_equals_a_new_field(row: int, column: int, height: int, width: int) -> None:
    random = np.random.default_rng(row * 100 + column)
    values = random.choice(
        np.array([FREE, UNKNOWN, OCCUPIED], np.int8), (40, 60), p=[0.9, 0.05, 0.05]
    )
    field = LikelihoodField(Grid(values, Frame(0.05)), SIGMA, STRAY)
    window = random.choice(np.array([FREE, OCCUPIED], np.int8), (height, width))
    changed = values.copy()
    changed[row : row + height, column : column + width] = window

    field.renew(row, column, window)

    whole = LikelihoodField(Grid(changed, Frame(0.05)), SIGMA, STRAY)
    np.testing.assert_allclose(field.cells, whole.cells, atol=1e-5)


def test_fit_is_the_share_of_explained_beams() -> None:
    field = field_of([(20, 30)])
    points = np.array([[1.0, 0.0], [1.1, 0.0], [2.0, 0.5], [0.3, 0.0]])

    assert field.fit((0.525, 1.025, 0.0), points) == 0.5
    assert math.isnan(field.fit((0.0, 0.0, 0.0), np.zeros((0, 2))))


def test_map_without_obstacles_explains_nothing() -> None:
    field = field_of([])

    assert at(field, 0.5, 0.5, 0.0) == pytest.approx(math.log(STRAY), abs=1e-5)
    assert field.fit((0.5, 0.5, 0.0), np.array([[1.0, 0.0]])) == 0.0


def test_replaced_map_equals_a_new_one() -> None:
    random = np.random.default_rng(0)
    first = random.choice([FREE, OCCUPIED, UNKNOWN], (40, 60), p=[0.9, 0.05, 0.05]).astype(np.int8)
    second = first.copy()
    second[5:12, 20:50] = OCCUPIED
    frame = Frame(0.05, (1.0, -2.0, 0.3))
    kept = ScanMap(Grid(first, frame), SIGMA, STRAY)
    poses = random.uniform((0.0, -2.0, -3.0), (3.0, 0.0, 3.0), (20, 3)).T.copy()
    points = random.uniform(-2.0, 2.0, (30, 2))

    same, other = kept.replace(Grid(second, frame)), kept.replace(Grid(second[:30], frame))

    assert (same, other) == (True, False)
    made = ScanMap(Grid(second, frame), SIGMA, STRAY)
    for ours, theirs in ((kept.field, made.field), (kept.wide, made.wide)):
        np.testing.assert_array_equal(
            ours.log_likelihood(poses, points), theirs.log_likelihood(poses, points)
        )
