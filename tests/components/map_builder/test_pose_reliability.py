"""Tests of equation (2) without the absorbing ends of the paper."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.map_builder.pose_reliability import LEAST, MOST, REMOVAL, update

probability = st.floats(0.0, 1.0)


def after(reliability: float, *similarities: float) -> float:
    for similarity in similarities:
        reliability = update(reliability, similarity)
    return reliability


def test_one_agreement_raises_one_half_to_nine_tenths() -> None:
    assert update(0.5, 1.0) == pytest.approx(0.9)


@pytest.mark.parametrize(("start", "frames"), [(0.98, 3), (0.9, 2), (0.5, 1)])
def test_landmark_is_removed_after_the_documented_number_of_disagreements(
    start: float, frames: int
) -> None:
    assert after(start, *[0.0] * (frames - 1)) > REMOVAL
    assert after(start, *[0.0] * frames) <= REMOVAL


@given(probability, st.lists(probability, max_size=30))
def test_reliability_can_always_change_within_its_bounds(
    start: float, similarities: list[float]
) -> None:
    reliability = after(start, *similarities, 0.5)

    assert LEAST <= reliability <= MOST
    assert not math.isnan(reliability)
    assert update(reliability, 1.0) > reliability or reliability == MOST
    assert update(reliability, 0.0) < reliability or reliability == LEAST


@given(st.floats(0.03, 0.97))
def test_neutral_similarity_changes_nothing(reliability: float) -> None:
    assert update(reliability, 0.5) == pytest.approx(reliability)


@given(st.floats(0.1, 0.9), st.floats(0.1, 0.9), st.floats(0.1, 0.9))
def test_reliability_increases_with_similarity(reliability: float, a: float, b: float) -> None:
    low, high = sorted((a, b))

    assert update(reliability, low) <= update(reliability, high)
