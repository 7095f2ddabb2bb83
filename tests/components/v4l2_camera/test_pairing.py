"""Images are paired by their capture times, in whatever order they arrive."""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cairn.components.v4l2_camera.pairing import StampedImage, StereoPairer

PERIOD = 40_000_000
GREY = np.zeros((1, 1), np.uint8)


def image(captured: int) -> StampedImage:
    return StampedImage(GREY, captured, captured)


def paired(pairer: StereoPairer, *arrivals: tuple[int, int]) -> list[tuple[int, int]]:
    """The times of the pairs that images make, given as side and time in order of arrival."""
    pairs = [pairer.add(side, image(captured)) for side, captured in arrivals]
    return [(pair[0].captured, pair[1].captured) for pair in pairs if pair is not None]


def test_images_pair_whichever_side_arrives_first() -> None:
    pairer = StereoPairer(PERIOD // 2)

    assert paired(pairer, (0, 0), (1, 5), (1, 105), (0, 100)) == [(0, 5), (100, 105)]
    assert pairer.offset == 5
    assert pairer.pairs == 2
    assert pairer.unpaired == [0, 0]


def test_unpaired_images_are_counted() -> None:
    pairer = StereoPairer(PERIOD // 2)

    found = paired(pairer, (0, 0), (0, PERIOD), (1, PERIOD + 9), (1, 2 * PERIOD), (0, 3 * PERIOD))

    assert found == [(PERIOD, PERIOD + 9)]
    assert pairer.unpaired == [1, 0]


def test_nearer_one_of_two_candidates_is_paired() -> None:
    pairer = StereoPairer(PERIOD)

    assert paired(pairer, (0, 0), (0, 30_000_000), (1, 20_000_000)) == [(30_000_000, 20_000_000)]


def test_images_beyond_the_tolerance_are_not_paired() -> None:
    pairer = StereoPairer(PERIOD // 2)

    assert paired(pairer, (0, 0), (1, PERIOD // 2 + 1)) == []
    assert paired(StereoPairer(PERIOD // 2), (0, 0), (1, PERIOD // 2)) == [(0, PERIOD // 2)]


def test_missing_camera_does_not_fill_the_memory() -> None:
    pairer = StereoPairer(PERIOD // 2)

    assert paired(pairer, *((0, PERIOD * number) for number in range(100))) == []
    assert pairer.unpaired[0] == 97


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(-PERIOD // 2 + 5_000_000, PERIOD // 2 - 5_000_000),
    st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=20),
    st.data(),
)
def test_every_period_with_both_images_gives_a_pair(
    apart: int, came: list[tuple[bool, bool]], data: st.DataObject
) -> None:
    pairer = StereoPairer(PERIOD // 2)
    found: list[tuple[int, int]] = []
    for number, (left, right) in enumerate(came):
        arrivals = [(0, PERIOD * number)] * left + [(1, PERIOD * number + apart)] * right
        found += paired(pairer, *data.draw(st.permutations(arrivals)))

    both = [number for number, sides in enumerate(came) if all(sides)]
    assert found == [(PERIOD * number, PERIOD * number + apart) for number in both]
