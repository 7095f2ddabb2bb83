"""A device's own clock against the system's: when something really happened in the device."""

from __future__ import annotations

import math

_DRIFT = 5e-4  # no clock of a device is worse: 500 ppm [1]
_EARLY_S = 0.5  # all messages before may have been late by that, as when a busy computer begins
_TIMELY_S = 0.05  # what is no later than that is in time
_DOUBTED = 3  # so many, and none between them that is in time: a clock was set
_LATE_S = 3.0  # what is late for so long is not late: a clock was set


class DeviceClock:
    """Finds a device's time in the system's from when messages arrive that bear it.

    A message may come late, by the line or by a busy computer, but never early. So of all
    differences between arrival and the device's time the least one is nearest to the truth: it is
    kept, and given way as fast as clocks may drift from each other (500 ppm). Times on the device
    are counted by `ticks_per_s`, and wrap around at `2**bits` ticks.

    Two things cannot be: that a message arrives before it was sent, and that its time is before
    that of an earlier one, as a line keeps their order; a late one bears a later time all the same.
    One such time is damaged; several are of a clock that was set, as when the device was restarted.
    Until it is known which, the arrival stands for the time.
    """

    def __init__(self, ticks_per_s: float, bits: int) -> None:
        self._ticks_per_s = ticks_per_s
        self._modulus = 1 << bits
        self.jumps = 0
        """How often one of the two clocks was set."""
        self.restart()

    def restart(self) -> None:
        """Begin anew, as with another device, or after its power was off."""
        self._ticks: int | None = None
        self._turns = 0
        self._offset_s = math.inf
        self._at_s = 0.0
        self._believed_s = -math.inf
        self._timely_s = math.inf
        self._doubted = 0

    @property
    def in_doubt(self) -> bool:
        """Whether impossible times came, and it is not known yet why."""
        return self._doubted > 0

    def seconds(self, ticks: int) -> float:
        """The device's time [s], counted on beyond its wraps; ticks as they come."""
        if self._ticks is not None:
            ahead = (ticks - self._ticks) % self._modulus
            back = ahead > self._modulus // 2  # read before the last one: not a wrap
            if not back and ticks < self._ticks:
                self._turns += 1
            if back and ticks > self._ticks:
                self._turns -= 1
        self._ticks = ticks
        return (self._turns * self._modulus + ticks) / self._ticks_per_s

    def offset(self, device_s: float, arrived_s: float) -> float:
        """System's time minus device's [s], with what arrived at `arrived_s` [s] taken in.

        It includes the least time that a message takes on its way.
        """
        found = arrived_s - device_s
        if math.isinf(self._offset_s):
            return self._begin(device_s, arrived_s)
        allowed = self._offset_s + _DRIFT * max(0.0, arrived_s - self._at_s)
        late = found > allowed + _TIMELY_S
        impossible = found < allowed - _EARLY_S or device_s < self._believed_s
        if impossible or (late and self.in_doubt):
            self._doubted += 1
            return self._set(device_s, arrived_s) if self._doubted == _DOUBTED else found
        self._believed_s = device_s
        if not late:
            self._doubted = 0
            self._timely_s = arrived_s
        elif arrived_s - self._timely_s > _LATE_S:
            return self._set(device_s, arrived_s)
        self._offset_s = min(found, allowed)
        self._at_s = arrived_s
        return self._offset_s

    def _set(self, device_s: float, arrived_s: float) -> float:
        self.jumps += 1
        return self._begin(device_s, arrived_s)

    def _begin(self, device_s: float, arrived_s: float) -> float:
        self._offset_s = arrived_s - device_s
        self._at_s = self._timely_s = arrived_s
        self._believed_s = device_s
        self._doubted = 0
        return self._offset_s
