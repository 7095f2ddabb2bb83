"""The figures of a map's quality, as `cairn map build` and `cairn map save` print them."""

from __future__ import annotations

from cairn.components.slam.quality import MapQuality
from cairn.tools.mapping.live import quality_lines


def quality(loops: int) -> MapQuality:
    return MapQuality(
        scans=9, left_out=0, keyframes=9, driven_m=1.0, fit=0.9, loops=loops, loops_rejected=2,
        loop_error_m=0.003 * loops, loop_error_deg=0.1 * loops, entropy_bit=0.02, conflicts=0.05,
    )  # fmt: skip


def test_closed_loops_have_an_error_and_none_has_no_error() -> None:
    loops = [quality_lines(quality(count))[0].strip() for count in (1, 0)]

    assert loops == [
        "loops      1 closed, 2 rejected; they differ by 0.003 m, 0.10 deg",
        "loops      0 closed, 2 rejected",
    ]
