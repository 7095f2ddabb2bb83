"""The figures of a map's quality, as `cairn map build` and `cairn map save` print them."""

from __future__ import annotations

from cairn.components.slam.quality import MapQuality
from cairn.tools.mapping.cli import ProgressLines
from cairn.tools.mapping.live import quality_lines


def quality(loops: int) -> MapQuality:
    return MapQuality(
        scans=9, left_out=0, keyframes=9, driven_m=1.0, fit=0.9, loops=loops, loops_rejected=2,
        loop_error_m=0.003 * loops, loop_error_deg=0.1 * loops, on_walls=0.97,
    )  # fmt: skip


def test_closed_loops_have_an_error_and_none_has_no_error() -> None:
    loops = [quality_lines(quality(count))[0].strip() for count in (1, 0)]

    assert loops == [
        "loops      1 closed, 2 rejected; they differ by 0.003 m, 0.10 deg",
        "loops      0 closed, 2 rejected",
    ]


def test_progress_is_printed_every_ten_seconds_with_the_time_that_is_left() -> None:
    lines, times = list[str](), iter([0.0, 1.0, 4.0, 11.0, 12.0, 22.0, 33.0])
    report = ProgressLines(lines.append, lambda: next(times))

    for share in (0.0, 0.1, 0.25, 0.3, 0.5):
        report("records", share, f"{400 * share:.0f} of 400 records")
    report("loops", 0.0, "0 of 7 pairs of places compared")

    assert lines == [
        "records: 100 of 400 records; about 30 s left of it",
        "records: 200 of 400 records; about 21 s left of it",
        "loops: 0 of 7 pairs of places compared",
    ]
