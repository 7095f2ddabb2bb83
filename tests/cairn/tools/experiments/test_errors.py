"""Errors and uncertainty over time, and in phases."""

import numpy as np
import pytest

from cairn.tools.experiments.conditions import (
    AFTER,
    AT_ITS_WORD,
    BEFORE,
    NOT_UPDATED,
    REPAIRED,
    UNCHANGED,
    UNCHANGED_FIXED,
    UPDATED,
    Way,
    figures,
    together,
)
from cairn.tools.experiments.errors import Course, course_of
from tests.cairn.tools.experiments.written import pair, world

SURVEY = (0.0, {1: (2.0, 0.0)})


def course(*errors: float) -> Course:
    """A step for each error; uncertainty is half of it."""
    values = np.array(errors)
    stamps = np.array([0.25 + 0.5 * step for step in range(len(values))])
    return Course(stamps, values, values, values / 2, values / 2, values / 2, values / 2)


def way(unchanged: Course, other: Course, registered_at: float | None = 1.0) -> Way:
    courses = {
        UNCHANGED.name: unchanged,
        UPDATED.name: other,
        UNCHANGED_FIXED.name: other,
        NOT_UPDATED.name: other,
        **{condition.name: other for condition in AT_ITS_WORD},
    }
    return Way(1, courses, 0.5, registered_at, 1.5)


def test_what_is_told_is_gathered_in_steps() -> None:
    found = course_of(pair(off=0.3, until=10.0), world(SURVEY), 20.0)

    assert found.stamps[:2].tolist() == [0.25, 0.75]
    assert len(found.stamps) == 40
    np.testing.assert_allclose(found.position_error[:20], 0.3)
    np.testing.assert_allclose(found.position_sd[:20], 0.05)  # sqrt(0.03^2 + 0.04^2)
    np.testing.assert_allclose(found.position_spread[:20], 0.02)
    np.testing.assert_allclose(found.heading_spread[:20], 0.01)
    assert np.isnan(found.position_error[20:]).all()
    assert found.lost_share == 0.5


def test_errors_of_the_heading_are_the_short_way_round() -> None:
    made = pair()
    made.poses[:, 2] = np.pi - 0.1
    truth = world(SURVEY, poses=[(0.0, 0.0, -np.pi + 0.1)] * 201)

    np.testing.assert_allclose(course_of(made, truth, 20.0).heading_error, 0.2)


def test_a_way_is_split_at_the_change_and_at_the_registration() -> None:
    one = way(course(1.0, 2.0, 3.0), course(1.0, 5.0, 7.0))

    assert one.phase(UPDATED.name, BEFORE).position_error.tolist() == [1.0]
    assert one.phase(UPDATED.name, AFTER).position_error.tolist() == [5.0, 7.0]
    assert one.phase(UPDATED.name, REPAIRED).position_error.tolist() == [7.0]
    assert one.phase(UNCHANGED.name, REPAIRED).position_error.tolist() == [3.0]


def test_who_registers_nothing_has_no_phase_after_that() -> None:
    one = way(course(1.0, 2.0, 3.0), course(1.0, 5.0, 7.0), registered_at=None)

    assert one.phase(UPDATED.name, REPAIRED).stamps.size == 0


def test_conditions_are_compared_in_the_same_phases_of_the_same_ways() -> None:
    ways = [way(course(1.0, 2.0, 2.0), course(1.0, 3.0, 3.0))]
    ways.append(way(course(9.0, 8.0, 8.0), course(9.0, 12.0, 12.0)))

    found = {(one.condition, one.phase, one.quantity): one for one in figures(ways)}

    assert found[UPDATED.name, BEFORE, "position_sd"].against_unchanged.mean == 1.0
    after = found[UPDATED.name, AFTER, "position_sd"]
    assert after.value.mean == pytest.approx((1.5 + 6.0) / 2)
    assert after.against_unchanged.mean == pytest.approx(1.5)
    # A map that is fixed is compared with itself.
    assert found[NOT_UPDATED.name, AFTER, "position_sd"].against_unchanged.mean == 1.0


def test_ways_are_drawn_over_the_time_that_all_of_them_have() -> None:
    ways = [way(course(1.0, 2.0, 3.0), course(1.0)), way(course(1.0, 2.0), course(1.0, 2.0))]

    stamps, rows = together(ways, UNCHANGED.name, "position_error")

    assert stamps.tolist() == [0.25, 0.75]
    assert rows.tolist() == [[1.0, 2.0], [1.0, 2.0]]
