"""Diagnostics of a device, as ROS 2's tools read them on topic `diagnostics`; measured rates."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.diagnostic_msgs import DiagnosticArray, DiagnosticStatus, KeyValue
from cairn.schemas.std_msgs import Header

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


def diagnostics(
    now: int,
    name: str,
    hardware_id: str,
    level: int,
    message: str,
    values: Mapping[str, object],
) -> DiagnosticArray:
    """Return the message that reports the state of one device.

    Args:
        now: time of the component's clock [ns].
        name: the component's name.
        hardware_id: what identifies this device among others of its kind, such as a serial number.
        level: `OK`, `WARN`, `ERROR` or `STALE`.
        message: the state in a few words.
        values: measured values and counts, sent as text.
    """
    pairs = tuple(KeyValue(key=key, value=_text(value)) for key, value in values.items())
    status = DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware_id, values=pairs
    )
    return DiagnosticArray(header=Header(stamp=from_ns(now)), status=(status,))


class RateWindow:
    """Measures the rate of arrivals within the last `window_s` seconds."""

    def __init__(self, window_s: float = 5.0) -> None:
        self._window_s = window_s
        self._times: deque[float] = deque()
        self._since: float | None = None

    def note(self, now: float) -> None:
        """Count an arrival at `now` [s of a monotonic clock]."""
        if self._since is None:
            self._since = now
        self._times.append(now)
        self._forget(now)

    def restart(self) -> None:
        """Forget all arrivals, after a pause whose reason is known."""
        self._times.clear()
        self._since = None

    def hz(self, now: float) -> float:
        """Return arrivals per second [Hz] until `now`; 0 if there were none within the window."""
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


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
