"""Finds children that hang, from their heartbeats: too long in one handler, or silent too long.

The supervisor kills them. Both times exclude pauses of the machine (`PauseAwareClock`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cairn.deployment.model import ChildSpec
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.supervision.child import ChildStatus

_SILENCE_S = 3.0
"""A process may be silent for so long beyond its limit for one handler: it may get no processor."""


@dataclass(frozen=True)
class Hang:
    """Where a child hangs, such as "on_scan", and for how many seconds."""

    where: str
    seconds: float


@dataclass
class _Heartbeat:
    status: ComponentStatus
    received_at: float


class HangDetector:
    """Keeps the last heartbeat of each child."""

    def __init__(self, specs: Mapping[str, ChildSpec], now: Callable[[], float]) -> None:
        """`now` is the time [s] without pauses of the machine."""
        self._specs = specs
        self._now = now
        self._heartbeats: dict[str, _Heartbeat] = {}

    def receive(self, status: ComponentStatus) -> None:
        """Keep a heartbeat, if it is that of a child."""
        if status.component in self._specs:
            self._heartbeats[status.component] = _Heartbeat(status, self._now())

    def check(self, child: ChildStatus) -> Hang | None:
        """Return where a child hangs, None if it does not, or has sent no heartbeat yet."""
        heartbeat = self._heartbeats.get(child.name)
        if child.state != "active" or heartbeat is None:
            return None
        status, spec = heartbeat.status, self._specs[child.name]
        if status.restarts + 1 != child.incarnation or status.state != "active":
            return None  # from before the last restart
        silent_s = self._now() - heartbeat.received_at
        if status.handler and status.handler_s > spec.handler_limit_s:
            return Hang(status.handler, status.handler_s + silent_s)
        if silent_s > spec.hang_timeout_s + _SILENCE_S and spec.placement == "process":
            return Hang(_where_silent(status), silent_s)
        return None


def _where_silent(status: ComponentStatus) -> str:
    """Return where a component hangs whose process does not even send heartbeats."""
    import psutil  # imported here to keep `from cairn import Supervisor` light

    try:
        if psutil.Process(status.pid).status() == psutil.STATUS_STOPPED:
            return "a process that was stopped by a signal such as SIGSTOP"
    except psutil.Error:  # another user's, or just gone
        pass
    return f"{status.handler or 'a call'} that lets no other thread of its process run"
