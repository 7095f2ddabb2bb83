"""A made-up device that measures evenly, however late its driver is called."""

from collections.abc import Iterator


class EvenTurns:
    """Counts the turns of a device, which began half a turn before it was first looked at."""

    def __init__(self, now: int, hz: float) -> None:
        self.period = round(1_000_000_000 / hz)
        self.number = -1
        self._began = now - self.period // 2

    @property
    def ended(self) -> int:
        """When the turn that is looked at ended [ns]."""
        return self._began + self.number * self.period

    def look(self, now: int) -> Iterator[None]:
        """Go through the turns that have ended since the last look [ns]; the line keeps them."""
        while self.number < (now - self._began) // self.period:
            self.number += 1
            yield
