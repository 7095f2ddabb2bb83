"""What a test reads of a topic: every message with its time of arrival."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from cairn.bus.bus import Node, Subscription
from cairn.bus.qos import LATCHED, Qos
from cairn.schemas.message import InvalidMessage

M = TypeVar("M")

LIMIT_S = 60.0
"""A message that does not come within this time does not come, unless told otherwise."""

MANY = Qos("best_effort", "volatile", 1000)
"""So deep that no message is lost while the test is busy."""

RETAINED = LATCHED.with_depth(100)
"""For latched topics: with what was sent before."""


@dataclass(frozen=True)
class Arrival(Generic[M]):
    """A message, when it came [ns since 1970], and the deployment's time then [ns]."""

    message: M
    at_ns: int
    clock_ns: int


class Reading(Generic[M]):
    """Follows a topic until it is closed; `arrivals` grows as messages come."""

    def __init__(
        self,
        node: Node,
        topic: str,
        message: type[M],
        qos: Qos,
        clock: Callable[[int], int],
        keep: Callable[[M], M],
    ) -> None:
        """`clock` gives the deployment's time at a system time; `keep` what to keep of a message.

        Raises nothing for a topic that nobody writes: nothing comes, then.
        """
        self.topic = topic
        self.arrivals: list[Arrival[M]] = []
        self.invalid: list[str] = []
        self._clock = clock
        self._keep = keep
        self._changed = threading.Condition()
        with self._changed:  # the first message may come before the subscription is known here
            self._subscription: Subscription = node.subscribe(topic, message, qos, self._take)

    @property
    def messages(self) -> list[M]:
        """The messages that have come so far."""
        return [arrival.message for arrival in self.arrivals]

    @property
    def count(self) -> int:
        """How many have come: a mark, for `after`."""
        return len(self.arrivals)

    def await_count(
        self, count: int, *, after: int = 0, limit_s: float = LIMIT_S
    ) -> list[Arrival[M]]:
        """Wait for so many messages after the first `after`; these.

        Raises `AssertionError`, telling how many came, if they do not come within the limit.
        """

        def enough(arrivals: Sequence[Arrival[M]]) -> bool:
            return len(arrivals) >= count

        self.await_that(enough, f"{count} messages", after=after, limit_s=limit_s)
        return self.arrivals[after : after + count]

    def await_that(
        self,
        so: Callable[[Sequence[Arrival[M]]], bool],
        what: str,
        *,
        after: int = 0,
        limit_s: float = LIMIT_S,
    ) -> None:
        """Wait until what came after the first `after` is as wanted.

        Raises `AssertionError` with `what` was wanted if it is not so within the limit.
        """
        with self._changed:
            found = self._changed.wait_for(lambda: so(self.arrivals[after:]), limit_s)
            came = len(self.arrivals) - after
        damaged = f"; invalid: {self.invalid[-1]}" if self.invalid else ""
        assert found, f"{self.topic}: not within {limit_s:g} s: {what}; {came} came{damaged}"

    def stays_silent(self, seconds: float) -> bool:
        """Whether no message comes within so long."""
        before = self.count
        with self._changed:
            return not self._changed.wait_for(lambda: len(self.arrivals) > before, seconds)

    def await_silence(self, seconds: float, limit_s: float = LIMIT_S) -> None:
        """Wait until no message has come for so long; `AssertionError` if it never is silent."""
        deadline = time.monotonic() + limit_s
        while not self.stays_silent(seconds):
            assert time.monotonic() < deadline, f"{self.topic}: not silent within {limit_s:g} s"

    def close(self) -> None:
        """Read no more; what came is kept."""
        self._subscription.close()

    def __enter__(self) -> "Reading[M]":
        """Read until the end of the context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Read no more."""
        self.close()

    def _take(self) -> None:
        at_ns = time.time_ns()
        with self._changed:
            try:
                message: Any = self._subscription.take()
            except InvalidMessage as error:
                self.invalid.append(str(error))
            else:
                if message is not None:
                    kept = self._keep(message)
                    self.arrivals.append(Arrival(kept, at_ns, self._clock(at_ns)))
            self._changed.notify_all()
