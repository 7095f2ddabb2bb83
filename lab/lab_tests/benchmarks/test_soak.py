"""The soak distinguishes growth from a warm-up and from noise."""

import pytest

from cairn_lab.benchmarks.soak import LIMIT_PERCENT
from cairn_lab.campaign.growth import growth_percent

WARM_UP_S = 60.0


@pytest.mark.parametrize(
    ("leak_per_s", "grows"), [(0.0, False), (0.005, False), (0.05, True)], ids=str
)
def test_growth_after_the_warm_up_counts(leak_per_s: float, grows: bool) -> None:
    samples = [
        (at_s, min(at_s, WARM_UP_S) + 100.0 + at_s * leak_per_s + (at_s % 15 == 0))
        for at_s in (5.0 * number for number in range(120))
    ]

    assert (growth_percent(samples, WARM_UP_S) > LIMIT_PERCENT) is grows


def test_too_short_a_time_does_not_count_as_growth() -> None:
    assert growth_percent([(0.0, 1.0), (239.0, 9.0)], 0.0) == 0.0
