"""How old each input is, and which is too old to move by."""

from __future__ import annotations

from cairn import SECOND
from cairn.planar.odometry import began_anew


class Freshness:
    """The time of the newest message of each input, by the input's name."""

    def __init__(self) -> None:
        self._times: dict[str, int] = {}

    def note(self, name: str, stamp: int, now: int) -> None:
        """Note a message of `stamp` [ns] taken at `now` [ns]; one from the future is of now."""
        newest = self._times.get(name, 0)
        if began_anew(newest, now):
            newest = 0
        self._times[name] = max(min(stamp, now), newest)

    def complaint(self, name: str, topic: str, timeout_s: float, now: int, called: str = "") -> str:
        """Return why an input, `called` so in words, is too old, with age and topic; else ""."""
        time = self._times.get(name)
        if time is None:
            return f"no {called or name} yet on {topic}"
        if began_anew(time, now):
            return f"no {called or name} since time was set back on {topic}"
        age = (now - time) / SECOND
        return "" if age <= timeout_s else f"no {called or name} for {age:.2f} s on {topic}"
