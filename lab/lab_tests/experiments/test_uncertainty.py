"""Errors and uncertainty by condition and phase, and what a wrong map does, in words."""

from __future__ import annotations

import numpy as np
import pytest

from cairn_lab.experiments.series import ErrorCurve
from cairn_lab.experiments.statistics import bootstrap_mean, bootstrap_ratio, rate_within
from cairn_lab.experiments.uncertainty import (
    AFTER,
    BEFORE,
    CERTAIN_CONDITIONS,
    CHANGED,
    CHANGED_FIXED,
    QUANTITIES,
    REPAIRED,
    TOLERANCE,
    UNCHANGED,
    UNCHANGED_FIXED,
    ConditionSummary,
    SeedCurves,
    common_time,
    describe_repair,
    summarize_conditions,
)
from tests.wording import assert_words

SIMILAR = [1.0, 1.01, 0.99, 1.0, 1.0]
NEVER = float("nan")


def curve(*errors: float) -> ErrorCurve:
    """A step for each error; uncertainty is half of it."""
    values = np.array(errors)
    stamps = np.array([0.25 + 0.5 * step for step in range(len(values))])
    return ErrorCurve(stamps, values, values, values / 2, values / 2, values / 2, values / 2)


def seed(unchanged: ErrorCurve, other: ErrorCurve, registered_at: float | None = 1.0) -> SeedCurves:
    curves = {
        UNCHANGED.name: unchanged,
        CHANGED.name: other,
        UNCHANGED_FIXED.name: other,
        CHANGED_FIXED.name: other,
        **{condition.name: other for condition in CERTAIN_CONDITIONS},
    }
    return SeedCurves(1, curves, 0.5, registered_at, 1.5)


def test_curves_are_split_at_the_change_and_at_the_registration() -> None:
    one = seed(curve(1.0, 2.0, 3.0), curve(1.0, 5.0, 7.0))

    assert one.phase(CHANGED.name, BEFORE).position_error.tolist() == [1.0]
    assert one.phase(CHANGED.name, AFTER).position_error.tolist() == [5.0, 7.0]
    assert one.phase(CHANGED.name, REPAIRED).position_error.tolist() == [7.0]
    assert one.phase(UNCHANGED.name, REPAIRED).position_error.tolist() == [3.0]


def test_without_a_registration_there_is_no_phase_after_it() -> None:
    one = seed(curve(1.0, 2.0, 3.0), curve(1.0, 5.0, 7.0), registered_at=None)

    assert one.phase(CHANGED.name, REPAIRED).stamps.size == 0


@pytest.mark.accuracy
def test_conditions_are_compared_in_the_same_phase_of_the_same_seeds() -> None:
    curves = [seed(curve(1.0, 2.0, 2.0), curve(1.0, 3.0, 3.0))]
    curves.append(seed(curve(9.0, 8.0, 8.0), curve(9.0, 12.0, 12.0)))

    found = {(one.condition, one.phase, one.quantity): one for one in summarize_conditions(curves)}

    assert found[CHANGED.name, BEFORE, "position_sigma"].against_unchanged.mean == 1.0
    after = found[CHANGED.name, AFTER, "position_sigma"]
    assert after.value.mean == pytest.approx((1.5 + 6.0) / 2)
    assert after.against_unchanged.mean == pytest.approx(1.5)
    # A fixed map is compared with the same fixed map.
    assert found[CHANGED_FIXED.name, AFTER, "position_sigma"].against_unchanged.mean == 1.0


def test_curves_are_drawn_over_the_time_that_all_seeds_have() -> None:
    curves = [seed(curve(1.0, 2.0, 3.0), curve(1.0)), seed(curve(1.0, 2.0), curve(1.0, 2.0))]

    stamps, rows = common_time(curves, UNCHANGED.name, "position_error")

    assert stamps.tolist() == [0.25, 0.75]
    assert rows.tolist() == [[1.0, 2.0], [1.0, 2.0]]


def described(
    fixed: dict[str, list[float]], updated: dict[str, list[float]], seeds: int = 5
) -> tuple[list[str], dict[str, str]]:
    """Return the sentences, and the rows of the table by quantity, for ratios of each seed.

    A quantity that is not named is as in the unchanged room.
    """
    summaries = {}
    for condition, phase, ratios in (
        (CHANGED_FIXED, AFTER, fixed),
        (CHANGED_FIXED, REPAIRED, fixed),
        (CHANGED, REPAIRED, updated),
    ):
        for quantity in QUANTITIES:
            values = np.array(ratios.get(quantity, SIMILAR[:seeds]))
            reference = np.ones(len(values))
            summaries[condition.name, phase, quantity] = ConditionSummary(
                condition=condition.name,
                phase=phase,
                quantity=quantity,
                value=bootstrap_mean(values),
                against_unchanged=bootstrap_ratio(values, reference),
                seeds_near_unchanged=rate_within(values, reference, TOLERANCE),
            )
    lines = [line for line in describe_repair(summaries, CHANGED, CHANGED_FIXED, seeds) if line]
    rows = {q: line for q, title in QUANTITIES.items() for line in lines if line.startswith(title)}
    return [line for line in lines if line.endswith(".")], rows


def test_effect_of_a_wrong_map_is_described_with_intervals() -> None:
    wrong = {
        "position_error": [1.5, 1.4, 1.6, 1.5, 1.5],
        "position_spread": [0.8] * 5,
        "heading_error": [0.7, 1.5, 0.8, 1.4, 1.2],
    }

    (harm, *_), _ = described(wrong, {})

    assert "larger than in the unchanged room: position error +50.0 % [+44.0, +56.0]; " in harm
    assert "smaller: position spread -20.0 % [-20.0, -20.0]; " in harm
    assert harm.endswith(
        "no significant difference: position sigma, heading spread, heading sigma, heading error."
    )


def test_recovered_quantity_is_listed_with_its_seeds() -> None:
    (_, returned, certain), rows = described({}, {"position_error": [1.06, 1.08, 1.02, 1.05, 1.12]})

    assert_words(returned, "6 of 6", "10 %")
    assert_words(certain, "Certain", "5 seeds", "10 %")
    assert rows["position_error"].split("]")[-1].split() == ["yes", "4", "of", "5"]


def test_quantity_that_has_not_recovered_is_named() -> None:
    rest = {"position_error": [1.3, 1.2, 1.25, 1.3, 1.2], "position_sigma": [0.8] * 5}

    (_, returned, certain), rows = described({}, rest)

    assert_words(returned, "4 of 6", "10 %")
    assert returned.endswith(
        "; not: position sigma -20.0 % [-20.0, -20.0], position error +25.0 % [+21.0, +29.0]."
    )
    assert certain.startswith("Certain with 5 seeds")
    assert rows["position_error"].split("]")[-1].split() == ["no", "0", "of", "5"]


def test_interval_across_the_tolerance_is_not_certain() -> None:
    (_, returned, uncertain), rows = described({}, {"position_error": [1.0, 1.4, 0.9, 1.0, 1.1]})

    assert "6 of 6" in returned
    assert uncertain.startswith("Not certain with 5 seeds: position error;")
    assert "yes, not certain" in rows["position_error"]


def test_seeds_without_a_registration_are_counted() -> None:
    updated = {quantity: [1.0, 1.0, 1.0, 1.0, NEVER] for quantity in QUANTITIES}

    (_, left_out, *_), rows = described({}, updated)

    assert left_out.startswith("In 1 of 5 seeds the moved object was not registered again")
    assert rows["position_error"].endswith("4 of 4")


def test_without_any_registration_the_effect_of_a_repair_is_unknown() -> None:
    sentences, rows = described({}, {quantity: [NEVER] * 5 for quantity in QUANTITIES})

    assert sentences[-1].startswith("In 0 of 5 seeds the moved object was registered again")
    assert not rows


def test_single_seed_cannot_distinguish_an_effect_from_chance() -> None:
    (harm, _, rest), rows = described({"position_error": [4.7]}, {}, seeds=1)

    assert "position error +370.0 %, " in harm
    assert harm.endswith("1 seed cannot distinguish this from chance.")
    assert_words(rest, "1 seed cannot", "chance")
    assert "yes, not certain" in rows["position_error"]


def test_few_seeds_are_never_certain() -> None:
    (_, _, rest), rows = described({}, {"position_error": [1.0, 1.0, 1.0]}, seeds=3)

    assert_words(rest, "3 seeds cannot", "chance")
    assert "yes, not certain" in rows["position_error"]
