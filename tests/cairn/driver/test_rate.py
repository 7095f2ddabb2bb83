"""How often something comes is told from when it came."""

from __future__ import annotations

import pytest

from cairn.driver.rate import RateWindow


def test_even_arrivals() -> None:
    window = RateWindow()
    for number in range(100):
        window.note(0.1 * number)

    assert window.hz(9.95) == pytest.approx(10.0)


def test_nothing_yet_or_one_alone_is_no_rate() -> None:
    window = RateWindow()
    assert window.hz(1.0) == 0.0
    window.note(1.0)
    assert window.hz(1.5) == 0.0


def test_the_rate_falls_once_they_cease() -> None:
    window = RateWindow(window_s=5.0)
    for number in range(100):
        window.note(0.1 * number)

    assert window.hz(11.9) == pytest.approx(30 / 5, rel=0.1)
    assert window.hz(20.0) == 0.0


def test_after_a_pause_that_is_accounted_for_it_begins_anew() -> None:
    window = RateWindow()
    window.note(0.0)
    window.restart()
    window.note(3.0)
    window.note(3.5)

    assert window.hz(3.6) == pytest.approx(2.0)
