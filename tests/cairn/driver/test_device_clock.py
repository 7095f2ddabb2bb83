"""`DeviceClock` follows a device's clock through wraps, drift, late messages and resets."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.driver.device_clock import DeviceClock, ahead_of_monotonic

_MODULUS = 1 << 24


@given(st.integers(0, _MODULUS - 1), st.lists(st.integers(0, _MODULUS // 2), max_size=50))
def test_time_continues_across_wraps(begin: int, steps: list[int]) -> None:
    clock = DeviceClock(1000, 24)
    truth, shown = [begin], begin
    for step in steps:
        shown += step
        truth.append(shown)

    seconds = [clock.seconds(ticks % _MODULUS) for ticks in truth]

    for (before, after), step in zip(pairwise(seconds), steps, strict=True):
        assert after - before == pytest.approx(step / 1000, abs=1e-6)


def test_one_damaged_stamp_is_not_counted_as_a_wrap() -> None:
    clock = DeviceClock(1000, 24)
    begin = clock.seconds(1000)
    clock.seconds(900)  # an older one
    clock.seconds(_MODULUS - 5)  # nonsense

    assert clock.seconds(1025) - begin == pytest.approx(0.025)


def test_offset_is_the_smallest_delay_and_late_messages_are_ignored() -> None:
    clock = DeviceClock(1000, 24)
    offsets = [
        clock.offset(t, 100.0 + t + late)
        for t, late in [(0.0, 0.03), (0.1, 0.01), (0.2, 0.5), (0.3, 2.0), (0.4, 0.01)]
    ]

    assert offsets[0] == pytest.approx(100.03)
    assert offsets[1:] == pytest.approx([100.01] * 4, abs=0.002)
    assert clock.jumps == 0


@pytest.mark.parametrize("drift", [300e-6, -300e-6])
def test_drifting_clocks_are_followed(drift: float) -> None:
    clock = DeviceClock(1000, 24)
    for number in range(10_000):
        arrived = 0.1 * number
        found = clock.offset(arrived * (1.0 + drift), arrived + 0.002)

    assert found == pytest.approx(0.002 - drift * arrived, abs=0.001)
    assert clock.jumps == 0


@dataclass
class Stream:
    """Messages of a device: time sent [s], stamp [ms], and delay [s] of each."""

    sent: list[float]
    shown: list[int]
    late: list[float]

    def errors(self, clock: DeviceClock) -> list[float]:
        """Return the error of each message's time as the driver computes it [s]."""
        found, arrived = [], 0.0
        for sent, ticks, late in zip(self.sent, self.shown, self.late, strict=True):
            arrived = max(arrived, sent + late)  # a link keeps their order
            device_s = clock.seconds(ticks % _MODULUS)
            found.append(device_s + clock.offset(device_s, arrived) - sent)
        return found


@st.composite
def restarted_devices(draw: st.DrawFn) -> Stream:
    """A device that is silent for a while, and whose clock then restarts at any value."""
    period_ms, away_ms = draw(st.sampled_from([25, 100, 200])), draw(st.integers(0, 2000))
    before, after = draw(st.integers(3, 20)), 20
    numbers = range(before + after)
    sent = [100_000 + period_ms * n + (away_ms if n >= before else 0) for n in numbers]
    # Another clock: before an earlier time of the old one, or ahead by more than may be late.
    other = draw(st.integers(away_ms + period_ms + 100, _MODULUS - 1000))
    start = draw(st.integers(0, _MODULUS - 1))
    shown = [start + ms - (other if n >= before else 0) for n, ms in enumerate(sent)]
    random = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    latest = draw(st.sampled_from([0.002, 0.02, 0.5]))
    return Stream([ms / 1000 for ms in sent], shown, list(random.uniform(0, latest, len(sent))))


@settings(max_examples=200, deadline=None)
@given(restarted_devices())
def test_restarted_device_is_followed_from_its_first_message(stream: Stream) -> None:
    errors = stream.errors(DeviceClock(1000, 24))

    # An impossible delay of less than 0.05 s is not detected.
    assert errors == pytest.approx([0.0] * len(errors), abs=max(stream.late) + 0.05)


@settings(max_examples=200, deadline=None)
@given(restarted_devices(), st.data())
def test_one_damaged_stamp_affects_no_other_message(stream: Stream, data: st.DataObject) -> None:
    stream.late = [0.002] * len(stream.late)
    at = data.draw(st.integers(1, len(stream.shown) - 1))
    # A stamp that is ahead by less than the largest delay cannot be distinguished from a valid one.
    stream.shown[at] += data.draw(st.integers(600, _MODULUS - 1))
    clock = DeviceClock(1000, 24)

    errors = stream.errors(clock)

    # A time that is set back to between two messages may be that of a late one.
    assert abs(errors.pop(at)) < stream.sent[at] - stream.sent[at - 1] + 0.06
    assert errors == pytest.approx([0.0] * len(errors), abs=0.06)
    assert clock.jumps <= 3


def test_late_message_is_not_mistaken_for_a_restart() -> None:
    late = [2.5 if number % 30 == 10 else 0.002 for number in range(200)]
    sent = [0.1 * number for number in range(200)]
    clock = DeviceClock(1000, 24)

    errors = Stream(sent, [round(1000 * s) for s in sent], late).errors(clock)

    assert errors == pytest.approx([0.002] * 200, abs=0.0015)
    assert clock.jumps == 0


def test_late_first_messages_do_not_bias_the_offset() -> None:
    sent = [0.1 * number for number in range(20)]
    late = [0.4, 0.3, *[0.002] * 18]
    clock = DeviceClock(1000, 24)

    errors = Stream(sent, [round(1000 * s) for s in sent], late).errors(clock)

    assert errors[5:] == pytest.approx([0.002] * 15, abs=0.0015)
    assert clock.jumps == 0


def test_restart_forgets_the_previous_device() -> None:
    clock = DeviceClock(1000, 24)
    clock.offset(clock.seconds(5000), 100.0)
    clock.restart()

    assert clock.seconds(10) == pytest.approx(0.01)
    assert clock.offset(0.01, 200.0) == pytest.approx(199.99)


def test_clock_is_compared_with_the_monotonic_one() -> None:
    before = time.time_ns()
    now = time.monotonic_ns() + ahead_of_monotonic(time.time_ns)
    after = time.time_ns()

    assert before - 1_000_000 <= now <= after + 1_000_000


class InterruptedThread:
    """Time as a thread reads it that is interrupted for 3 s after some of its readings."""

    def __init__(self, interrupted: set[int]) -> None:
        self._interrupted = interrupted
        self._readings = 0
        self._now = 1_000_000_000

    def monotonic_ns(self) -> int:
        now = self._now
        self._readings += 1
        self._now += 3_000_000_000 if self._readings in self._interrupted else 100
        return now

    def system_ns(self) -> int:
        return 7_000_000_000 + self.monotonic_ns()


@pytest.mark.parametrize("interrupted", [{1}, {2}, {1, 5}, {2, 4, 7}])
def test_interrupted_comparison_of_clocks_is_repeated(
    interrupted: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    thread = InterruptedThread(interrupted)
    monkeypatch.setattr("cairn.driver.device_clock.time", thread)

    assert ahead_of_monotonic(thread.system_ns) == pytest.approx(7_000_000_000, abs=1000)
