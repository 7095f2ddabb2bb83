"""How a camera is, by what has become of its pictures since that was last told."""

from dataclasses import replace

import pytest

from cairn.components.v4l2_camera.counts import Counts, health
from cairn.driver.diagnostics import ERROR, OK, WARN

BEFORE = Counts(pictures=100, lost=7, skipped=3, marked=1)


@pytest.mark.parametrize(
    ("changes", "rate", "nominal", "trouble", "told"),
    [
        ({"pictures": 125}, 25.0, 25.0, "", (OK, "25 pictures a second")),
        ({"pictures": 125}, 25.0, 0.0, "", (OK, "25 pictures a second")),
        ({"pictures": 125}, 25.0, 25.0, "it is away", (ERROR, "it is away")),
        ({}, 25.0, 25.0, "", (ERROR, "no picture comes")),
        ({"marked": 26}, 0.0, 25.0, "", (ERROR, "no picture comes (25 damaged)")),
        ({"pictures": 112}, 12.0, 25.0, "", (WARN, "12 pictures a second instead of 25")),
        (
            {"pictures": 120, "lost": 10, "skipped": 5},
            25.0,
            25.0,
            "",
            (WARN, "pictures 3 lost, 2 skipped"),
        ),
        # A camera that is slow by agreement need not have given one within a second.
        ({}, 0.5, 0.5, "", (OK, "0.5 pictures a second")),
        ({}, 0.0, 0.5, "", (ERROR, "no picture comes")),
    ],
)
def test_health(
    changes: dict[str, int], rate: float, nominal: float, trouble: str, told: tuple[int, str]
) -> None:
    assert health(replace(BEFORE, **changes), BEFORE, rate, nominal, trouble) == told
