"""How often something comes, against how often it should."""

from __future__ import annotations

from collections import deque


class RateWindow:
    """Counts arrivals of the last `window_s` seconds."""

    def __init__(self, window_s: float = 5.0) -> None:
        self._window_s = window_s
        self._times: deque[float] = deque()
        self._since: float | None = None

    def note(self, now: float) -> None:
        """Count one that came at `now` [s of a monotonic clock]."""
        if self._since is None:
            self._since = now
        self._times.append(now)
        self._forget(now)

    def restart(self) -> None:
        """Begin anew: what comes after a pause that is accounted for is not measured by it."""
        self._times.clear()
        self._since = None

    def hz(self, now: float) -> float:
        """Arrivals a second until `now`; 0 if nothing came for as long as the window."""
        self._forget(now)
        if self._since is None or len(self._times) < 2:
            return 0.0
        # Between arrivals there are periods; the one that is under way counts once it is overdue.
        period = (self._times[-1] - self._times[0]) / (len(self._times) - 1)
        waiting = now - self._times[-1]
        if waiting <= 2.0 * period:
            return 1.0 / period if period > 0 else 0.0
        return (len(self._times) - 1) / (now - self._times[0])

    def _forget(self, now: float) -> None:
        while self._times and self._times[0] < now - self._window_s:
            self._times.popleft()
