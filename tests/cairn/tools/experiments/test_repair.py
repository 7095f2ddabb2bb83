"""What a wrong map does, and whether a repaired one undoes it, in words that follow the figures."""

from __future__ import annotations

import numpy as np

from cairn.tools.experiments.conditions import (
    AFTER,
    NEAR,
    NOT_UPDATED,
    QUANTITIES,
    REPAIRED,
    UPDATED,
    Figure,
)
from cairn.tools.experiments.repair import repair
from cairn.tools.experiments.statistics import mean_of, near_of, ratio_of

AS_BEFORE = [1.0, 1.01, 0.99, 1.0, 1.0]
NEVER = float("nan")


def told(
    fixed: dict[str, list[float]], kept: dict[str, list[float]], ways: int = 5
) -> tuple[list[str], dict[str, str]]:
    """The sentences, and the rows of the table by quantity, for ratios of each way.

    Where nothing is said of a quantity, it is as in the unchanged room.
    """
    found = {}
    for condition, phase, ratios in (
        (NOT_UPDATED, AFTER, fixed),
        (NOT_UPDATED, REPAIRED, fixed),
        (UPDATED, REPAIRED, kept),
    ):
        for quantity in QUANTITIES:
            values = np.array(ratios.get(quantity, AS_BEFORE[:ways]))
            reference = np.ones(len(values))
            found[condition.name, phase, quantity] = Figure(
                condition=condition.name,
                phase=phase,
                quantity=quantity,
                value=mean_of(values),
                against_unchanged=ratio_of(values, reference),
                ways_near_unchanged=near_of(values, reference, NEAR),
            )
    lines = [line for line in repair(found, UPDATED, NOT_UPDATED, ways) if line]
    rows = {q: line for q, title in QUANTITIES.items() for line in lines if line.startswith(title)}
    return [line for line in lines if line.endswith(".")], rows


def test_what_a_wrong_map_raises_and_lowers_is_told_with_intervals() -> None:
    wrong = {
        "position_error": [1.5, 1.4, 1.6, 1.5, 1.5],
        "position_spread": [0.8] * 5,
        "heading_error": [0.7, 1.5, 0.8, 1.4, 1.2],
    }

    (harm, *_), _ = told(wrong, {})

    assert "more than in the unchanged room: error of position +50.0 % [+44.0, +56.0]; " in harm
    assert "less: samples' position -20.0 % [-20.0, -20.0]; " in harm
    assert harm.endswith(
        "no difference that the ways can tell: stated position, samples' heading, stated heading, "
        "error of heading."
    )


def test_what_is_back_is_told_with_the_ways_in_which_it_is() -> None:
    (_, back, certain), rows = told({}, {"position_error": [1.06, 1.08, 1.02, 1.05, 1.12]})

    assert back.endswith("6 of 6 are back to within 10 % of the unchanged room's.")
    assert certain == "5 ways can tell: no interval reaches across 10 %."
    assert rows["position_error"].split("]")[-1].split() == ["yes", "4", "of", "5"]


def test_what_is_not_back_is_named() -> None:
    left = {"position_error": [1.3, 1.2, 1.25, 1.3, 1.2], "position_sd": [0.8] * 5}

    (_, back, certain), rows = told({}, left)

    assert "4 of 6 are back" in back
    assert back.endswith(
        "; not: stated position -20.0 % [-20.0, -20.0], error of position +25.0 % [+21.0, +29.0]."
    )
    assert certain.startswith("5 ways can tell")
    assert rows["position_error"].split("]")[-1].split() == ["no", "0", "of", "5"]


def test_an_interval_across_the_limit_cannot_tell() -> None:
    (_, back, unsure), rows = told({}, {"position_error": [1.0, 1.4, 0.9, 1.0, 1.1]})

    assert "6 of 6" in back
    assert unsure == "5 ways cannot tell for error of position: the interval reaches across 10 %."
    assert "yes, not sure" in rows["position_error"]


def test_ways_without_a_registration_are_counted() -> None:
    kept = {quantity: [1.0, 1.0, 1.0, 1.0, NEVER] for quantity in QUANTITIES}

    (_, left_out, *_), rows = told({}, kept)

    assert left_out.startswith("In 1 of 5 ways the moved object was not registered anew")
    assert rows["position_error"].endswith("4 of 4")


def test_where_nothing_was_registered_nothing_is_said_to_be_back() -> None:
    sentences, rows = told({}, {quantity: [NEVER] * 5 for quantity in QUANTITIES})

    assert sentences[-1].startswith("In none of 5 ways the moved object was registered anew")
    assert not rows


def test_one_way_cannot_tell() -> None:
    (harm, _, back), rows = told({"position_error": [4.7]}, {}, ways=1)

    assert "error of position +370.0 %, " in harm
    assert harm.endswith("1 way cannot tell whether that is chance.")
    assert back == "1 way cannot tell whether it is so in others."
    assert "yes, not sure" in rows["position_error"]


def test_few_ways_are_never_sure() -> None:
    (_, _, back), rows = told({}, {"position_error": [1.0, 1.0, 1.0]}, ways=3)

    assert back == "3 ways cannot tell whether it is so in others."
    assert "yes, not sure" in rows["position_error"]
