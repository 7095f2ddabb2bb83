"""Conversion of a device's own clock to system time, from the arrival times of its messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

_TRIES, _CLOSE_NS = 5, 5_000
_MOST_DRIFT = 5e-4  # clocks of devices drift less than this from the system's: 500 ppm [1]
_MOST_EARLY_S = 0.5  # all messages before may have been this late, as when a busy computer starts
_ON_TIME_S = 0.05  # a message that is less late than this is on time
_IMPOSSIBLE_BEFORE_RESET = 3  # this many, and none between them on time: a clock was set
_LONGEST_LATE_S = 3.0  # if all messages were late for this long, they are not: a clock was set


def ahead_of_monotonic(now: Callable[[], int]) -> int:
    """Return how far a clock is ahead of `time.monotonic_ns` at present [ns].

    To be measured for every stamp: the system's clock is slewed and set, the other one never. The
    clocks are read one after the other, and again if the thread was interrupted in between.

    Args:
        now: reads the clock [ns], such as `self.clock.now` of a component.
    """
    least, offset = math.inf, 0
    for _ in range(_TRIES):
        before = time.monotonic_ns()
        read = now()
        took = time.monotonic_ns() - before
        if took < least:
            least, offset = took, read - before - took // 2
        if took <= _CLOSE_NS:
            break
    return offset


class DeviceClock:
    """Converts a device's time stamps to system time, the clock that takes the arrival times.

    For each message, in order of arrival:

        device_s = clock.seconds(ticks)  # the stamp of the message
        stamped_s = device_s + clock.offset(device_s, arrived_s)

    Take `arrived_s` from `time.monotonic()` on the device thread, right after the read that
    returned the last byte of the message. `stamped_s` is then of `time.monotonic()`, too: publish
    it plus `ahead_of_monotonic(self.clock.now)`, or `self.clock.now()` minus the age,
    `time.monotonic() - stamped_s`. Use one clock per device, and a new one (or `restart`) whenever
    the device is opened again.

    A message may arrive late, because of the line or a busy computer, but never early. Of all
    differences between arrival time and device time the smallest one is therefore nearest to the
    truth. The clock keeps it, and lets it grow as fast as clocks may drift apart (500 ppm). Device
    time counts `ticks_per_s`, and wraps around at `2**bits` ticks.

    The offset contains the shortest time that a message takes from its stamp to its arrival, such
    as the transmission time of a serial line: `stamped_s` is late by it. If the line takes that
    time for every message (10 bits per byte at 8N1), subtract it from `arrived_s`.

    Two things are impossible: that a message arrives before it was sent, and that its stamp is
    older than that of an earlier message, because a line keeps their order. One impossible stamp is
    a damaged one; several in a row are of a clock that was set, as when the device restarted. Until
    it is known which, `offset` returns the difference of that very message: its arrival time then
    stands for the time.
    """

    def __init__(self, ticks_per_s: float, bits: int) -> None:
        self._ticks_per_s = ticks_per_s
        self._modulus = 1 << bits
        self.jumps = 0
        """How often one of the two clocks was set."""
        self.restart()

    def restart(self) -> None:
        """Forget everything, as for another device, or one whose power was off."""
        self._ticks: int | None = None
        self._wraps = 0
        self._offset_s = math.inf
        self._offset_at_s = 0.0
        self._newest_device_s = -math.inf
        self._last_on_time_s = math.inf
        self._impossible = 0

    @property
    def in_doubt(self) -> bool:
        """Whether impossible stamps arrived, and the reason is not known yet."""
        return self._impossible > 0

    def seconds(self, ticks: int) -> float:
        """Return the device's time [s], continued across its wraps. Call it for each stamp."""
        if self._ticks is not None:
            ahead = (ticks - self._ticks) % self._modulus
            is_older = ahead > self._modulus // 2  # taken before the previous one: not a wrap
            if not is_older and ticks < self._ticks:
                self._wraps += 1
            if is_older and ticks > self._ticks:
                self._wraps -= 1
        self._ticks = ticks
        return (self._wraps * self._modulus + ticks) / self._ticks_per_s

    def offset(self, device_s: float, arrived_s: float) -> float:
        """Return system time minus device time [s], after a message that arrived at `arrived_s`.

        Args:
            device_s: the message's stamp, as `seconds` returns it [s].
            arrived_s: when its last byte was read [s], of a clock that is not set, such as
                `time.monotonic()`; minus the transmission time, if that is known.

        The offset contains the shortest time that a message takes to arrive.
        """
        measured = arrived_s - device_s
        if math.isinf(self._offset_s):
            return self._start(device_s, arrived_s)
        allowed = self._offset_s + _MOST_DRIFT * max(0.0, arrived_s - self._offset_at_s)
        is_late = measured > allowed + _ON_TIME_S
        is_impossible = measured < allowed - _MOST_EARLY_S or device_s < self._newest_device_s
        if is_impossible or (is_late and self.in_doubt):
            self._impossible += 1
            if self._impossible == _IMPOSSIBLE_BEFORE_RESET:
                return self._reset(device_s, arrived_s)
            return measured
        self._newest_device_s = device_s
        if not is_late:
            self._impossible = 0
            self._last_on_time_s = arrived_s
        elif arrived_s - self._last_on_time_s > _LONGEST_LATE_S:
            return self._reset(device_s, arrived_s)
        self._offset_s = min(measured, allowed)
        self._offset_at_s = arrived_s
        return self._offset_s

    def _reset(self, device_s: float, arrived_s: float) -> float:
        self.jumps += 1
        return self._start(device_s, arrived_s)

    def _start(self, device_s: float, arrived_s: float) -> float:
        self._offset_s = arrived_s - device_s
        self._offset_at_s = self._last_on_time_s = arrived_s
        self._newest_device_s = device_s
        self._impossible = 0
        return self._offset_s
