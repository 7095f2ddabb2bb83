"""Watches how old the newest message of each input with a `max_age_s` is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from cairn.runtime.component import Component
from cairn.runtime.topic_ports import In
from cairn.schemas.builtin_interfaces import to_ns
from cairn.system.clock import SECOND

_CHECKS: Final = 5  # in the shortest of the ages
_SHORTEST_PERIOD_NS: Final = SECOND // 100


class InputAges:
    """Finds inputs that become stale, and those that are fresh again.

    The age of a message counts from its stamp if its class has a header with one, otherwise from
    the check that first sees it; that of an input without a message, from its activation.
    """

    def __init__(
        self,
        component: Component,
        inputs: Mapping[str, In[Any]],
        max_age_s: Mapping[str, float],
    ) -> None:
        """Watch the inputs (by port) for which `max_age_s` has an age [s]."""
        self._component = component
        self._inputs = {
            port: (inputs[port], round(age_s * SECOND)) for port, age_s in max_age_s.items()
        }
        self._since_ns: dict[str, int] = {}
        self._seen: dict[str, Any] = {}
        self._stale: set[str] = set()

    @property
    def period_ns(self) -> int:
        """The time between two checks [ns]; 0 if nothing is watched."""
        shortest = min((age_ns for _, age_ns in self._inputs.values()), default=0)
        return max(_SHORTEST_PERIOD_NS, shortest // _CHECKS) if shortest else 0

    def start(self) -> None:
        """Count from now on; called when the component is activated."""
        if not self._inputs:
            return
        now = self._component.clock.now()
        self._since_ns = dict.fromkeys(self._inputs, now)
        self._seen = {port: bound.latest for port, (bound, _) in self._inputs.items()}
        self._stale.clear()

    def check(self) -> None:
        """Log, show and hand to the component what has become stale or fresh since last time."""
        now = self._component.clock.now()
        for port, (bound, max_age_ns) in self._inputs.items():
            age_ns = self._age_ns(port, bound.latest, now)
            is_stale = age_ns > max_age_ns
            if is_stale and port not in self._stale:
                self._stale.add(port)
                self._note_stale(port, bound.topic, age_ns / SECOND, max_age_ns / SECOND)
            elif not is_stale and port in self._stale:
                self._stale.remove(port)
                self._component.report_problem(_subject(port), None)
                self._component.log.info("input fresh: %s on %s", port, bound.topic)
                self._component.on_fresh(port)

    def _age_ns(self, port: str, latest: Any, now: int) -> int:
        if latest is not self._seen.get(port):
            self._seen[port] = latest
            self._since_ns[port] = now
        stamp = getattr(getattr(latest, "header", None), "stamp", None)
        stamp_ns = 0 if stamp is None else to_ns(stamp)
        return now - (stamp_ns or self._since_ns[port])

    def _note_stale(self, port: str, topic: str, age_s: float, max_age_s: float) -> None:
        never = self._seen[port] is None
        found = f"nothing for {age_s:.2f} s" if never else f"the last is {age_s:.2f} s old"
        text = f"{found}, more than max_age_s, {max_age_s:g} s"
        self._component.log.warning("input stale: %s on %s: %s", port, topic, text)
        self._component.report_problem(_subject(port), f"no current {port}")
        self._component.on_stale(port, age_s)


def _subject(port: str) -> str:
    return f"age of {port}"
