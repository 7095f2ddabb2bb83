"""Feeds a view from the bus of a running deployment: logs, statuses, time."""

import threading
import time
from collections.abc import Callable
from typing import Any
from uuid import uuid4

from cairn.bus.bus import Bus, Subscription, full_name
from cairn.bus.qos import LATCHED, Qos
from cairn.cli.view import View
from cairn.clock import to_ns
from cairn.deployment.model import VIEW
from cairn.runtime.rosout import ROSOUT, ROSOUT_QOS
from cairn.runtime.runtime import STATUS_TOPIC
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.rosgraph_msgs import Clock

_FINISH_LIMIT_S = 1.0


def _not_woken() -> None:
    """What has come waits until the next refresh."""


class Watch:
    """Reads what a view shows, as one more node of the deployment: statuses and time."""

    def __init__(self, bus: Bus, robot: str, view: View, *, clock: bool) -> None:
        """`clock`: time is simulated, on topic `clock`."""
        self._view = view
        self._robot = robot
        self._node = bus.node(full_name(robot, VIEW), lambda _: None)
        self._sources: list[tuple[Subscription, Callable[[Any], None]]] = []
        status = full_name(robot, STATUS_TOPIC)
        self._add(status, ComponentStatus, LATCHED.with_depth(1000), view.status)
        if clock:
            newest = Qos("reliable", "volatile", 1)
            self._add(full_name(robot, CLOCK_TOPIC), Clock, newest, self._time)

    def refresh(self) -> None:
        """Pass on all that has come, then have the view drawn."""
        for subscription, show in self._sources:
            while True:
                try:
                    message = subscription.take()
                except InvalidMessage:
                    continue  # counted where it matters: at the components' own ports
                if message is None:
                    break
                show(message)
        self._view.refresh()

    def _add(
        self,
        topic: str,
        message: type[Any],
        qos: Qos,
        show: Callable[[Any], None],
        wake: Callable[[], None] = _not_woken,
    ) -> None:
        self._sources.append((self._node.subscribe(topic, message, qos, wake), show))

    def _time(self, told: Clock) -> None:
        self._view.time(to_ns(told.clock))


class LogWatch(Watch):
    """Reads the log messages of a robot too, from /rosout."""

    def __init__(
        self, bus: Bus, robot: str, view: View, *, clock: bool, hurry: Callable[[], None]
    ) -> None:
        """`hurry` asks for a refresh soon; it is called, on any thread, when some have come."""
        super().__init__(bus, robot, view, clock=clock)
        self._hurry = hurry
        self._news = threading.Event()  # some have come since the last refresh
        self._mark = Log(level=Log.DEBUG, name=f"{robot}.{VIEW}", msg=f"end of view {uuid4()}")
        self._marked = False
        self._marker = self._node.advertise(ROSOUT, Log, ROSOUT_QOS)
        self._add(ROSOUT, Log, ROSOUT_QOS, self._log, self._wake)

    def refresh(self) -> None:
        """Pass on all that has come, then have the view drawn."""
        self._news.clear()
        super().refresh()

    def finish(self) -> None:
        """Refresh until everything is shown that this process has logged."""
        deadline = time.monotonic() + _FINISH_LIMIT_S
        # What this process publishes comes back to it in the same order.
        self._marker.publish(self._mark)
        while True:
            self.refresh()
            if self._marked or not self._news.wait(max(0.0, deadline - time.monotonic())):
                return

    def _wake(self) -> None:
        if not self._news.is_set():
            self._news.set()
            self._hurry()

    def _log(self, entry: Log) -> None:
        if entry.name == self._mark.name:
            self._marked = self._marked or entry.msg == self._mark.msg
        elif entry.name.startswith(f"{self._robot}."):
            self._view.log(entry)
