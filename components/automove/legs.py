"""Numbers of legs: what AutoMove wants now, told apart from all that it ever wanted."""

from __future__ import annotations

_MODULUS = 2**32
_MILLISECOND = 1_000_000


class Legs:
    """Gives numbers that count up, and never one that a forerunner of this component gave.

    A number is the time in milliseconds [mod 2^32], or one more than the last where that is not
    later; 0 is left for those who know of no leg. So a forerunner's are all past, unless it gave
    more than a thousand a second.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def next(self, now: int) -> int:
        """The number of a leg that begins at `now` [ns]."""
        leg = now // _MILLISECOND % _MODULUS
        if self._last is not None:
            following = (self._last + 1) % _MODULUS
            if (leg - following) % _MODULUS >= _MODULUS // 2:
                leg = following
        self._last = leg or 1
        return self._last
