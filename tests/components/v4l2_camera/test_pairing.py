"""Pictures are paired with those taken at nearly the same time, whatever order they come in."""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cairn.components.v4l2_camera.pairing import Pairing, Picture

PERIOD = 40_000_000
GREY = np.zeros((1, 1), np.uint8)


def picture(taken: int) -> Picture:
    return Picture(GREY, taken, taken)


def paired(pairing: Pairing, *arrivals: tuple[int, int]) -> list[tuple[int, int]]:
    """The times of the pairs that pictures make, given as side and time in order of arrival."""
    pairs = [pairing.add(side, picture(taken)) for side, taken in arrivals]
    return [(pair[0].taken, pair[1].taken) for pair in pairs if pair is not None]


def test_pairs_are_made_whichever_side_comes_first() -> None:
    pairing = Pairing(PERIOD // 2)

    assert paired(pairing, (0, 0), (1, 5), (1, 105), (0, 100)) == [(0, 5), (100, 105)]
    assert pairing.apart == 5
    assert pairing.pairs == 2
    assert pairing.unpaired == [0, 0]


def test_a_picture_without_its_other_is_left_out_and_counted() -> None:
    pairing = Pairing(PERIOD // 2)

    found = paired(pairing, (0, 0), (0, PERIOD), (1, PERIOD + 9), (1, 2 * PERIOD), (0, 3 * PERIOD))

    assert found == [(PERIOD, PERIOD + 9)]
    assert pairing.unpaired == [1, 0]


def test_of_two_that_are_near_enough_the_nearer_is_taken() -> None:
    pairing = Pairing(PERIOD)

    assert paired(pairing, (0, 0), (0, 30_000_000), (1, 20_000_000)) == [(30_000_000, 20_000_000)]


def test_pictures_more_than_half_a_period_apart_make_no_pair() -> None:
    pairing = Pairing(PERIOD // 2)

    assert paired(pairing, (0, 0), (1, PERIOD // 2 + 1)) == []
    assert paired(Pairing(PERIOD // 2), (0, 0), (1, PERIOD // 2)) == [(0, PERIOD // 2)]


def test_a_camera_that_stays_away_leaves_nothing_piled_up() -> None:
    pairing = Pairing(PERIOD // 2)

    assert paired(pairing, *((0, PERIOD * number) for number in range(100))) == []
    assert pairing.unpaired[0] == 97


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(-PERIOD // 2 + 5_000_000, PERIOD // 2 - 5_000_000),
    st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=20),
    st.data(),
)
def test_every_period_of_which_both_pictures_come_gives_its_pair(
    apart: int, came: list[tuple[bool, bool]], data: st.DataObject
) -> None:
    pairing = Pairing(PERIOD // 2)
    found: list[tuple[int, int]] = []
    for number, (left, right) in enumerate(came):
        arrivals = [(0, PERIOD * number)] * left + [(1, PERIOD * number + apart)] * right
        found += paired(pairing, *data.draw(st.permutations(arrivals)))

    both = [number for number, sides in enumerate(came) if all(sides)]
    assert found == [(PERIOD * number, PERIOD * number + apart) for number in both]
