"""`RateWindow` measures the rate of arrivals."""

from __future__ import annotations

import pytest

from cairn.driver.diagnostics import RateWindow


def test_regular_arrivals_give_their_rate() -> None:
    window = RateWindow()
    for number in range(100):
        window.note(0.1 * number)

    assert window.hz(9.95) == pytest.approx(10.0)


def test_fewer_than_two_arrivals_give_rate_zero() -> None:
    window = RateWindow()
    assert window.hz(1.0) == 0.0
    window.note(1.0)
    assert window.hz(1.5) == 0.0


def test_rate_falls_when_arrivals_stop() -> None:
    window = RateWindow(window_s=5.0)
    for number in range(100):
        window.note(0.1 * number)

    assert window.hz(11.9) == pytest.approx(30 / 5, rel=0.1)
    assert window.hz(20.0) == 0.0


def test_restart_excludes_a_pause_from_the_rate() -> None:
    window = RateWindow()
    window.note(0.0)
    window.restart()
    window.note(3.0)
    window.note(3.5)

    assert window.hz(3.6) == pytest.approx(2.0)
