"""When a scan was measured: its first ray's time, on the system's monotonic clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cairn import SECOND
from cairn.components.hokuyo.device_facts import Measuring
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scip2 import ClockReading
from cairn.driver.device_clock import DeviceClock

_TICKS_PER_S, _BITS = 1000, 24
_LONGEST_COMPUTING_S = 0.5
_COMPUTING_SCANS = 100  # by which the least is found


class Stamping:
    """Makes stamps out of the sensor's clock, which it reads at step 0 of each turn.

    When a scan arrives tells when it was measured but for the time that it took from there: the
    turn up to the last step, the line, and what the sensor computes. The first two are known. If
    the sensor's clock was read just before (`calibrate`) the third is measured; else it is taken to
    be nothing.
    """

    def __init__(self, measuring: Measuring) -> None:
        self._turn_s, self._turn_steps = measuring.turn_s, measuring.turn_steps
        self._clock = DeviceClock(_TICKS_PER_S, _BITS)
        self._calibrated_s: float | None = None
        self._scans = 0
        self._last_ms: int | None = None
        self.computing_s: float | None = None
        """What a scan takes beside turn and line until it is there [s], if that was measured."""

    @property
    def jumps(self) -> int:
        """How often the sensor's clock was set."""
        return self._clock.jumps

    def calibrate(self, readings: Sequence[ClockReading]) -> bool:
        """Take readings of the sensor's clock; whether they agree on how it goes.

        A clock that shows `t` ms is between `t` and `t + 1`, and was read between question and
        answer: so each reading bounds the difference of the clocks from both sides.
        """
        if not readings:
            return False
        shown = [self._clock.seconds(reading.time_ms) for reading in readings]
        tick_s = 1.0 / _TICKS_PER_S
        least = max(r.asked / SECOND - s - tick_s for r, s in zip(readings, shown, strict=True))
        most = min(r.answered / SECOND - s for r, s in zip(readings, shown, strict=True))
        if least > most:
            return False
        self._calibrated_s = 0.5 * (least + most)
        return True

    def first_ray(
        self, time_ms: int | None, arrived: int, request: ScanRequest, line_s: float
    ) -> int:
        """When the first ray of a scan was measured [ns], from when it had come [ns].

        `line_s`: least time that the line takes for a scan [s].
        """
        # When the sensor had it ready, at the latest: what differs from request to request is off.
        turn_s = self._turn_s * (request.last + 1) / self._turn_steps
        ready_s = arrived / SECOND - line_s - turn_s
        if time_ms is None or time_ms == self._last_ms:  # there is no clock, or it stands still
            began_s = ready_s
        else:
            device_s = self._clock.seconds(time_ms)
            offset_s = self._clock.offset(device_s, ready_s)
            began_s = device_s + offset_s - self._computing(offset_s)
        self._last_ms = time_ms
        return round((began_s + self._turn_s * request.first / self._turn_steps) * SECOND)

    def _computing(self, offset_s: float) -> float:
        # Later the sensor's clock has drifted from where it was read, and this tells no more.
        tells = self._scans < _COMPUTING_SCANS and not self._clock.in_doubt
        if tells and self._calibrated_s is not None:
            self._scans += 1
            self._learn(offset_s - self._calibrated_s)
        return self.computing_s or 0.0

    def _learn(self, seen_s: float) -> None:
        if abs(seen_s) > _LONGEST_COMPUTING_S:
            return  # what was read is another clock, or this one was set since
        least_s = math.inf if self.computing_s is None else self.computing_s
        self.computing_s = min(least_s, max(0.0, seen_s))
