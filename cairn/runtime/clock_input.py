"""Keeps a component's simulated clock in step with topic `clock`."""

from collections.abc import Callable

from cairn.bus.bus import Node, Subscription
from cairn.bus.qos import Qos
from cairn.clock import SimulatedClock, to_ns
from cairn.runtime.loop import Scheduler
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rosgraph_msgs import Clock

TOPIC = "clock"
_NEWEST = Qos("reliable", "volatile", 1)


class ClockInput:
    """Reads clock messages (only the newest matters) and moves the clock and the timers."""

    def __init__(
        self,
        clock: SimulatedClock,
        node: Node,
        topic: str,
        scheduler: Scheduler,
        moved: Callable[[], None],
        complain: Callable[[str], None],
    ) -> None:
        self._clock = clock
        self._node = node
        self._topic = topic
        self._scheduler = scheduler
        self._moved = moved
        self._complain = complain
        self._subscription: Subscription | None = None

    def open(self) -> None:
        """Begin to follow the topic."""
        if self._subscription is None:
            self._subscription = self._node.subscribe(
                self._topic, Clock, _NEWEST, lambda: self._scheduler.deliver(self._deliver)
            )

    def _deliver(self) -> None:
        if self._subscription is None:
            return
        try:
            message = self._subscription.take()
        except InvalidMessage as error:
            self._complain(f"message on {self._topic} refused: {error}")
            return
        if message is not None:
            self._clock.set(to_ns(message.clock))
            self._moved()
