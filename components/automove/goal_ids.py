"""Numbers of goal_ids: what AutoMove wants now, told apart from all that it ever wanted."""

from __future__ import annotations

_MODULUS = 2**32
_MILLISECOND = 1_000_000


class GoalIds:
    """Gives numbers that count up, and never one that a forerunner of this component gave.

    A number is the time in milliseconds [mod 2^32], or one more than the last where that is not
    later; 0 means that there is no goal yet. So a forerunner's are all past, unless it gave more
    than a thousand a second.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def next(self, now: int) -> int:
        """The number of a goal_id that begins at `now` [ns]."""
        goal_id = now // _MILLISECOND % _MODULUS
        if self._last is not None:
            following = (self._last + 1) % _MODULUS
            if (goal_id - following) % _MODULUS >= _MODULUS // 2:
                goal_id = following
        self._last = goal_id or 1
        return self._last
