"""Stamps of scans: when the first ray was measured, on the system's monotonic clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cairn import SECOND
from cairn.components.hokuyo_scanner.client import ClockReading
from cairn.components.hokuyo_scanner.protocol import ScanRequest, SensorSpec
from cairn.driver.device_clock import DeviceClock

_TICKS_PER_S, _CLOCK_BITS = 1000, 24
_LONGEST_COMPUTING_S = 0.5
_COMPUTING_SCANS = 100  # over which the least computing time is found


class ScanStamper:
    """Computes stamps from the sensor's clock, which it reads at step 0 of each turn.

    The arrival of a scan shows when it was measured, but for the time that it took from there: the
    turn up to the last step, the line, and the sensor's computing. The first two are known. If the
    sensor's clock was read just before (`calibrate`) the third is measured; otherwise it is taken
    as 0.
    """

    def __init__(self, spec: SensorSpec) -> None:
        self._turn_s, self._turn_steps = spec.turn_s, spec.turn_steps
        self._clock = DeviceClock(_TICKS_PER_S, _CLOCK_BITS)
        self._calibrated_s: float | None = None
        self._scans = 0
        self._last_ms: int | None = None
        self.computing_s: float | None = None
        """Time from a scan's last step to its arrival, without the line [s], if measured."""

    @property
    def jumps(self) -> int:
        """How often the sensor's clock was set."""
        return self._clock.jumps

    def calibrate(self, readings: Sequence[ClockReading]) -> bool:
        """Use readings of the sensor's clock; return whether they agree with each other.

        A clock that shows `t` ms is between `t` and `t + 1`, and was read between command and
        reply: so each reading bounds the difference of the clocks from both sides.
        """
        if not readings:
            return False
        shown = [self._clock.seconds(reading.time_ms) for reading in readings]
        tick_s = 1.0 / _TICKS_PER_S
        least = max(r.sent / SECOND - s - tick_s for r, s in zip(readings, shown, strict=True))
        most = min(r.received / SECOND - s for r, s in zip(readings, shown, strict=True))
        if least > most:
            return False
        self._calibrated_s = 0.5 * (least + most)
        return True

    def first_ray(
        self, time_ms: int | None, arrived: int, request: ScanRequest, line_s: float
    ) -> int:
        """Return when the first ray of a scan was measured [ns, monotonic clock].

        Args:
            time_ms: the sensor's clock at step 0 [ms], None without one.
            arrived: when the scan's last byte was received [ns, monotonic clock].
            request: the requested scans.
            line_s: least time that the line takes for a scan [s].
        """
        # When the sensor had it ready, at the latest: without what differs between requests.
        turn_s = self._turn_s * (request.last + 1) / self._turn_steps
        ready_s = arrived / SECOND - line_s - turn_s
        if time_ms is None or time_ms == self._last_ms:  # no clock, or it stands still
            started_s = ready_s
        else:
            device_s = self._clock.seconds(time_ms)
            offset_s = self._clock.offset(device_s, ready_s)
            started_s = device_s + offset_s - self._computing(offset_s)
        self._last_ms = time_ms
        return round((started_s + self._turn_s * request.first / self._turn_steps) * SECOND)

    def _computing(self, offset_s: float) -> float:
        # Later the sensor's clock has drifted from its readings, which are not valid any more.
        is_comparable = self._scans < _COMPUTING_SCANS and not self._clock.in_doubt
        if is_comparable and self._calibrated_s is not None:
            self._scans += 1
            self._update_computing(offset_s - self._calibrated_s)
        return self.computing_s or 0.0

    def _update_computing(self, measured_s: float) -> None:
        if abs(measured_s) > _LONGEST_COMPUTING_S:
            return  # the readings are of another clock, or this one was set since
        least_s = math.inf if self.computing_s is None else self.computing_s
        self.computing_s = min(least_s, max(0.0, measured_s))
