"""The rules that ours is compared with do what their papers say, with their weaknesses."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.map_builder.letter import equation_2, judge_to_the_letter
from cairn.components.map_builder.objects import Evidence, Kind, State, Verdict
from cairn.components.map_builder.persistence import PersistenceFilter
from cairn.components.map_builder.visual_map import VisualMap
from tests.components.map_builder.evidence import HERE, THERE, sighting, surveyed

PROBABILITIES = st.floats(0.0, 1.0)


@given(PROBABILITIES, PROBABILITIES)
def test_equation_2_stays_a_probability(reliability: float, similarity: float) -> None:
    assert 0.0 <= equation_2(reliability, similarity) <= 1.0


def test_equation_2_is_that_of_the_paper() -> None:
    assert equation_2(0.5, 0.9) == pytest.approx(0.9)
    assert equation_2(0.9, 0.9) == pytest.approx(0.81 / 0.82)
    assert equation_2(0.9, 0.1) == pytest.approx(0.5)


def test_to_the_letter_an_object_that_agreed_fully_once_is_never_doubted_again() -> None:
    visual_map = VisualMap([surveyed()], rule=judge_to_the_letter)

    visual_map.apply([sighting(1.0, 0)], 0.0)
    for step in range(1, 30):
        visual_map.apply([sighting(0.05, step, THERE)], 0.0)

    assert visual_map.objects[7].reliability == 1.0


def test_to_the_letter_one_bad_sighting_moves_a_new_object() -> None:
    visual_map = VisualMap([surveyed()], rule=judge_to_the_letter)

    first = visual_map.apply([sighting(0.05, 0, THERE)], 0.0).changes
    second = visual_map.apply([sighting(0.05, 0, THERE)], 0.0).changes

    assert [change.kind for change in (*first, *second)] == [Kind.REMOVED, Kind.REGISTERED]
    assert visual_map.objects[7].place == THERE


def test_a_feature_that_is_detected_persists_and_fades_while_nobody_looks() -> None:
    persistence = PersistenceFilter(lifetime_s=600.0)
    known = surveyed()
    for step in range(6):
        known, _ = persistence(known, sighting(0.9, step), float(step))
    believed = known.reliability

    later, _ = persistence(known, sighting(0.9, 9), 605.0)

    assert believed > 0.99
    assert later.reliability < believed


def test_a_feature_that_is_missed_is_removed_and_registered_where_it_is_seen() -> None:
    visual_map = VisualMap([surveyed()], rule=PersistenceFilter())
    for step in range(4):
        visual_map.apply([sighting(0.9, step)], float(step))

    kinds = []
    for step in range(4, 16):
        away = Evidence(7, 0.1, Verdict.DISAGREES, 9.0, THERE, (0.2 * step, 0.0, 0.0), healthy=True)
        kinds += [change.kind for change in visual_map.apply([away], float(step)).changes]

    assert kinds == [Kind.REMOVED, Kind.REGISTERED]
    assert visual_map.objects[7].state is State.LIVE


def test_the_recursion_is_the_persistence_filter_with_an_exponential_prior() -> None:
    """Against the sums of the paper: p(x_t | y) = p(y | t) S(t) / p(y), S the survival prior."""
    missed, false, lifetime = 0.3, 0.02, 50.0
    persistence = PersistenceFilter(missed, false, lifetime)
    observed = [(1.0, True), (4.0, False), (9.0, True), (15.0, False), (16.0, False)]

    known = surveyed()
    persistence(known, sighting(0.9, -1), 0.0)  # the clock begins
    belief = 0.5
    last = 0.0
    for at_s, detected in observed:
        belief = persistence._updated(belief, detected, at_s - last)
        last = at_s

    def likelihood(gone_at: float) -> float:
        product = 1.0
        for at_s, detected in observed:
            there = at_s <= gone_at
            chance = (
                (1 - missed if there else false) if detected else (missed if there else 1 - false)
            )
            product *= chance
        return product

    # Before the first look it stood with probability 0.5; if so, it goes at an exponential time.
    times = [0.0, *(at_s for at_s, _ in observed)]
    gone = 0.5 * likelihood(-1.0)
    for begin, end in itertools.pairwise(times):
        mass = math.exp(-begin / lifetime) - math.exp(-end / lifetime)
        gone += 0.5 * mass * likelihood(0.5 * (begin + end))
    stands = 0.5 * math.exp(-times[-1] / lifetime) * likelihood(math.inf)

    assert belief == pytest.approx(stands / (stands + gone))


def test_the_rules_to_compare_with_place_new_objects_too() -> None:
    for rule in (judge_to_the_letter, PersistenceFilter()):
        visual_map = VisualMap([], rule=rule)
        for step in range(6):
            visual_map.apply([sighting(0.9, step, HERE)], 0.0)

        assert visual_map.objects[7].state is State.LIVE
