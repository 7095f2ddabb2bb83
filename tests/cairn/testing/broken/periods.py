"""A made-up device that measures evenly, however late its driver is called."""

from collections.abc import Iterator


class Periods:
    """Counts the turns of a device, whose first turn began half a turn before `now`."""

    def __init__(self, now: int, hz: float) -> None:
        self.period = round(1_000_000_000 / hz)
        self.number = -1
        self._began = now - self.period // 2

    @property
    def ended(self) -> int:
        """The end of the current turn [ns]."""
        return self._began + self.number * self.period

    def completed(self, now: int) -> Iterator[None]:
        """Iterate over the turns that ended between the last call and `now` [ns]."""
        while self.number < (now - self._began) // self.period:
            self.number += 1
            yield
