"""What arrives on a topic of a ROS 2 node: whether it is timely, its rate, and its silence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from cairn.driver.diagnostics import ERROR, OK, WARN, RateWindow, diagnostics
from cairn.runtime.component import Component
from cairn.runtime.rate_limited_log import RateLimitedLog
from cairn.schemas.builtin_interfaces import Time, to_ns
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.system.clock import SECOND, has_passed

_FUTURE_S: Final = 0.1  # how far the clocks of two computers may differ
_SLOW: Final = 0.8  # share of the nominal rate below which diagnostics warn
_RESOLVED_S: Final = 5.0  # without a rejection, until all messages count as usable again


@dataclass(frozen=True)
class SourceLimits:
    """Nominal rate [Hz], silence that is an error [s], highest age [s], whose clock stamps."""

    rate: float
    timeout_s: float
    age_s: float
    stamp_on_arrival: bool


class Ros2Source:
    """Judges what arrives on one topic of a ROS 2 node, and reports it.

    A driver asks for each message's `stamp_of`, `why_untimely` and `why_out_of_order`, and calls
    `reject` or `accept`. `report`, called once per second, logs what is wrong and that it is over.
    """

    def __init__(
        self, component: Component, topic: str, what: str, consequence: str, limits: SourceLimits
    ) -> None:
        """Judge the messages on `topic`.

        Args:
            component: the driver, whose clock and log are used.
            topic: full name of the topic.
            what: what arrives, such as `the base's odometry`.
            consequence: of its silence, such as `the base is not driven`.
            limits: when a message or the source is late.
        """
        self._component = component
        self._now = component.clock.now
        self.topic = topic
        """Full name of the topic."""
        self._what = what
        self._consequence = consequence
        self._limits = limits
        self._warnings = RateLimitedLog(component.log)
        self._rate = RateWindow()
        self._last_arrival: int | None = None
        self._newest: int | None = None
        self._reason, self._rejected_at = "", 0
        self._noted: set[str] = set()
        self.rejected = 0

    @property
    def is_usable(self) -> bool:
        """Whether the source is not silent: a message was accepted within `timeout_s`."""
        last = self._last_arrival
        return last is not None and self._now() - last <= self._limits.timeout_s * SECOND

    def is_ahead(self, stamp: int) -> bool:
        """Return whether a time [ns] is ahead of the clock; an accepted one: time was set back."""
        return stamp > self._now() + _FUTURE_S * SECOND

    def stamp_of(self, stamp: Time) -> int:
        """Return the time of a message with this stamp [ns]."""
        return self._now() if self._limits.stamp_on_arrival else to_ns(stamp)

    def why_untimely(self, stamp: int) -> str | None:
        """Return why a message of this time [ns] is too old or too new; None if it is not."""
        age = (self._now() - stamp) / SECOND
        if age <= self._limits.age_s and not self.is_ahead(stamp):
            return None
        relation = f"{age:.2f} s old" if age > 0 else f"{-age:.2f} s in the future"
        return (
            f"{self._what} on {self.topic} is {relation} on arrival; synchronize both computers' "
            "clocks (chrony), or set stamp_on_arrival"
        )

    def why_out_of_order(self, stamp: int) -> str | None:
        """Return why a message of this time [ns] does not follow the newest; None if it does."""
        if self._newest is None or stamp > self._newest or self.is_ahead(self._newest):
            return None
        return (
            f"{self._what} on {self.topic} arrived twice or out of order, "
            f"{(self._newest - stamp) / SECOND:.2f} s before the newest; check that only one node "
            "publishes this topic"
        )

    def reject(self, reason: str) -> None:
        """Count a message that cannot be used, and log why, at a limited rate."""
        self.rejected += 1
        self._reason, self._rejected_at = reason, self._now()
        self._warnings.warn("rejected", reason)

    def note_once(self, what: str) -> None:
        """Log once how the source's messages are understood where they do not say it.

        `what` has no values of a message, so that there are few of them.
        """
        if what not in self._noted:
            self._noted.add(what)
            self._component.log.warning("%s on %s: %s", self._what, self.topic, what)

    def accept(self, stamp: int) -> bool:
        """Count a message that is used; return whether it is the first one after a silence."""
        was_silent = not self.is_usable
        if was_silent:
            self._rate.restart()  # the pause was reported already
        self._last_arrival = self._now()
        self._rate.note(self._last_arrival / SECOND)
        if self._newest is None or stamp > self._newest or self.is_ahead(self._newest):
            self._newest = stamp
        return was_silent

    def report(self, healthy: tuple[int, str], values: dict[str, object]) -> DiagnosticArray:
        """Log what has changed; return the diagnostics.

        `healthy` is the level and text while messages arrive as they should; `values` are added.
        """
        now = self._now()
        problem = None if self.is_usable else self._why_unusable()
        self._component.report_problem(self.topic, problem)
        if problem is None:
            self._warnings.resolved("silence", f"{self._what} arrives again on {self.topic}")
        else:
            self._warnings.warn("silence", problem)
        if has_passed(_RESOLVED_S, self._rejected_at, now):
            self._warnings.resolved("rejected", f"{self._what} on {self.topic} is usable again")
        hz, nominal = self._rate.hz(now / SECOND), self._limits.rate
        level, text = healthy
        if problem is not None:
            level, text = ERROR, problem
        elif level == OK and hz < _SLOW * nominal:
            level = WARN
            text = f"{self._what} arrives on {self.topic} at {hz:.1f} Hz instead of {nominal:g} Hz"
        known = {"rate [Hz]": hz, "nominal rate [Hz]": nominal, "rejected": self.rejected}
        name = self._component.name
        return diagnostics(now, name, self.topic, level, text, {**known, **values})

    def _why_unusable(self) -> str:
        if self._reason and not has_passed(self._limits.timeout_s, self._rejected_at, self._now()):
            return f"{self._consequence}: {self._reason}"
        return (
            f"{self._consequence}: {self._what} does not arrive on {self.topic}; check that its "
            "node runs, that its ROS_DOMAIN_ID is that of the deployment, and that both use the "
            "same router"
        )
