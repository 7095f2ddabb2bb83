"""Health of a camera, judged by what happened since the last report."""

from dataclasses import replace

import pytest

from cairn.components.v4l2_camera.frames import FrameCounts
from cairn.components.v4l2_camera.health import judge
from cairn.driver.diagnostics import ERROR, OK, WARN

BEFORE = FrameCounts(images=100, lost=7, dropped=3, marked=1)


@pytest.mark.parametrize(
    ("changes", "rate", "nominal", "device_error", "expected"),
    [
        ({"images": 125}, 25.0, 25.0, "", (OK, "25 images per second")),
        ({"images": 125}, 25.0, 0.0, "", (OK, "25 images per second")),
        ({"images": 125}, 25.0, 25.0, "it is away", (ERROR, "it is away")),
        ({}, 25.0, 25.0, "", (ERROR, "no images arrive")),
        ({"marked": 26}, 0.0, 25.0, "", (ERROR, "no images arrive (25 damaged)")),
        ({"images": 112}, 12.0, 25.0, "", (WARN, "12 images per second instead of 25")),
        (
            {"images": 120, "lost": 10, "dropped": 5},
            25.0,
            25.0,
            "",
            (WARN, "images 3 lost, 2 dropped"),
        ),
        # A camera that is slow by agreement need not have given one within a second.
        ({}, 0.5, 0.5, "", (OK, "0.5 images per second")),
        ({}, 0.0, 0.5, "", (ERROR, "no images arrive")),
    ],
)
def test_health_depends_on_events_since_the_last_report(
    changes: dict[str, int],
    rate: float,
    nominal: float,
    device_error: str,
    expected: tuple[int, str],
) -> None:
    assert judge(replace(BEFORE, **changes), BEFORE, rate, nominal, device_error) == expected
