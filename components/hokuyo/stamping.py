"""When a scan was measured: its first ray's time, on the system's monotonic clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cairn.clock import SECOND
from cairn.driver.device_clock import DeviceClock
from components.hokuyo.device_facts import Measuring
from components.hokuyo.requests import ScanRequest
from components.hokuyo.scip2 import ClockReading

_TICKS_PER_S, _BITS = 1000, 24
_LONGEST_WAY_S = 1.0
_WAY_SCANS = 100  # by which the least way is found


class Stamping:
    """Makes stamps out of the sensor's clock, which it reads at step 0 of each turn.

    When a scan arrives tells when it was measured but for the time that it took from there: the
    turn up to the last step, what the sensor computes, and the line. If the sensor's clock could
    be read (`calibrate`) that time is measured; else it is taken to be the turn and the line alone.
    """

    def __init__(self, measuring: Measuring) -> None:
        self._turn_s, self._turn_steps = measuring.turn_s, measuring.turn_steps
        self._clock = DeviceClock(_TICKS_PER_S, _BITS)
        self._calibrated_s: float | None = None
        self._scans = 0
        self._last_ms: int | None = None
        self.way_s: float | None = None
        """What a scan takes from step 0 until it is there [s], if that was measured."""

    @property
    def jumps(self) -> int:
        """How often the sensor's clock, or the system's, was set."""
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
        arrived_s = arrived / SECOND
        least_way_s = line_s + self._turn_s * (request.last + 1) / self._turn_steps
        if time_ms is None or time_ms == self._last_ms:  # there is no clock, or it stands still
            began_s = arrived_s - least_way_s
        else:
            device_s = self._clock.seconds(time_ms)
            offset_s = self._clock.offset(device_s, arrived_s)
            began_s = device_s + offset_s - self._way(offset_s, least_way_s)
        self._last_ms = time_ms
        return round((began_s + self._turn_s * request.first / self._turn_steps) * SECOND)

    def _way(self, offset_s: float, least_way_s: float) -> float:
        if self._calibrated_s is None:
            return least_way_s
        # Later the sensor's clock has drifted from where it was read, and this is no way any more.
        if self._scans < _WAY_SCANS:
            self._scans += 1
            self.way_s = min(self.way_s or math.inf, offset_s - self._calibrated_s)
        assert self.way_s is not None  # since the first scan
        if 0.0 <= self.way_s <= _LONGEST_WAY_S:
            return self.way_s
        self._calibrated_s = self.way_s = None  # what was read is another clock than that of scans
        return least_way_s
