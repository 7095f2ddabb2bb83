"""The display of `cairn up`: what it reads on the bus, and the lines that it prints."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol
from uuid import uuid4

from cairn.bus.bus import Bus, Subscription, full_name
from cairn.bus.qos import LATCHED, Qos
from cairn.deployment.model import ROOT, VIEW
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.log_output import LONGEST_RECORD, TokenBucket
from cairn.runtime.rosout import ROSOUT, ROSOUT_QOS, render
from cairn.runtime.runtime import STATUS_TOPIC
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.schemas.builtin_interfaces import from_ns, to_ns
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.rosgraph_msgs import Clock

_FINISH_LIMIT_S = 10.0  # what this process publishes comes back in milliseconds
_STATUS_POLL_S = 0.02  # statuses wait for the next refresh
# Log records displayed at once and continually [1/s]: any program on the bus can publish them.
_MOST_AT_ONCE, _MOST_HZ = 1000.0, 50.0
_REPORT_S = 10.0
_LONGEST_READ_S = 0.05  # of a topic, at each refresh


class View(Protocol):
    """Displays a running deployment."""

    def log(self, entry: Log) -> None:
        """Display a log message."""

    def status(self, status: ComponentStatus) -> None:
        """Keep the last status of a component."""

    def time(self, now: int) -> None:
        """Keep the time [ns] of the deployment's clock."""

    def refresh(self) -> None:
        """Update the display."""


class PlainView:
    """Prints log messages as lines."""

    def __init__(self, print_line: Callable[[str], None]) -> None:
        self._print = print_line

    def log(self, entry: Log) -> None:
        """Print the message."""
        self._print(render(entry))

    def status(self, status: ComponentStatus) -> None:
        """Do nothing: states are in the log as well."""

    def time(self, now: int) -> None:
        """Do nothing: lines have their own time."""

    def refresh(self) -> None:
        """Do nothing: every line is printed at once."""


def _no_wake() -> None:
    """Do nothing: messages wait until the next refresh."""


class Watch:
    """Reads statuses and time for a view, as one more node of the deployment."""

    def __init__(self, bus: Bus, robot: str, view: View, *, clock: bool, node: str = VIEW) -> None:
        """`clock` says that time is simulated, and published on topic `clock`."""
        self._view = view
        self._robot = robot
        self._node = bus.node(full_name(robot, node), lambda _: None)
        self._sources: list[tuple[Subscription, Callable[[Any], None]]] = []
        status = full_name(robot, STATUS_TOPIC)
        self._add(status, ComponentStatus, LATCHED.with_depth(1000), self._status)
        if clock:
            newest = Qos("reliable", "volatile", 1)
            self._add(full_name(robot, CLOCK_TOPIC), Clock, newest, self._time)

    def refresh(self) -> None:
        """Pass the messages received to the view, as many as it takes in time, then draw it."""
        for subscription, show in self._sources:
            # A program may publish faster than this can read: the caller has more to do.
            deadline = time.monotonic() + _LONGEST_READ_S
            while time.monotonic() < deadline:
                try:
                    message = subscription.take()
                except InvalidMessage:
                    continue  # the components' own ports count it
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
        wake: Callable[[], None] = _no_wake,
    ) -> None:
        self._sources.append((self._node.subscribe(topic, message, qos, wake), show))

    def _status(self, status: ComponentStatus) -> None:
        self._view.status(status)

    def _time(self, message: Clock) -> None:
        self._view.time(to_ns(message.clock))


class LogWatch(Watch):
    """Also reads the log messages of a robot, from /rosout."""

    def __init__(
        self,
        bus: Bus,
        robot: str,
        view: View,
        *,
        clock: bool,
        hurry: Callable[[], None],
        root: str = ROOT,
        node: str = VIEW,
    ) -> None:
        """Listen as the node of that name to a robot whose root here has the name `root`.

        `hurry` requests a refresh soon; it is called, on any thread, when messages arrive.
        """
        super().__init__(bus, robot, view, clock=clock, node=node)
        self._hurry = hurry
        self._root = root
        self._news = threading.Event()  # messages have arrived since the last refresh
        self._mark = Log(level=Log.DEBUG, name=f"{robot}.{VIEW}", msg=f"end of view {uuid4()}")
        self._marked = False
        self._root_ended = False  # its last status is displayed
        self._allowed = TokenBucket(_MOST_AT_ONCE, _MOST_HZ, time.monotonic())
        self._suppressed = 0
        self._reported = 0.0
        self._marker = self._node.advertise(ROSOUT, Log, ROSOUT_QOS, shared=True)
        self._add(ROSOUT, Log, ROSOUT_QOS, self._log, self._wake)

    def refresh(self) -> None:
        """Pass all messages received to the view, then draw it."""
        self._news.clear()
        super().refresh()
        self._report_suppressed()

    def finish(self) -> None:
        """Refresh until everything that this process has published is displayed."""
        deadline = time.monotonic() + _FINISH_LIMIT_S
        # What this process publishes on a topic comes back to it in the same order.
        self._marker.publish(self._mark)
        while True:
            self.refresh()
            left_s = deadline - time.monotonic()
            if (self._marked and self._root_ended) or left_s <= 0:
                self._report_suppressed(now=True)
                return
            self._news.wait(min(left_s, _STATUS_POLL_S))

    def _wake(self) -> None:
        if not self._news.is_set():
            self._news.set()
            self._hurry()

    def _status(self, status: ComponentStatus) -> None:
        super()._status(status)
        if status.component == self._root and status.state == LifecycleState.FINALIZED:
            self._root_ended = True

    def _log(self, entry: Log) -> None:
        if entry.name == self._mark.name:
            self._marked = self._marked or entry.msg == self._mark.msg
        elif entry.name.startswith(f"{self._robot}."):
            if not self._allowed.take(time.monotonic()):
                self._suppressed += 1
            elif len(entry.msg) > LONGEST_RECORD:
                self._view.log(replace(entry, msg=f"{entry.msg[:LONGEST_RECORD]} ..."))
            else:
                self._view.log(entry)

    def _report_suppressed(self, *, now: bool = False) -> None:
        at_s = time.monotonic()
        if self._suppressed and (now or at_s - self._reported >= _REPORT_S):
            text = f"suppressed {self._suppressed} log records here; the log files have those of "
            name, stamp = f"{self._robot}.{VIEW}", from_ns(time.time_ns())
            self._view.log(Log(stamp=stamp, level=Log.WARN, name=name, msg=f"{text}components"))
            self._suppressed, self._reported = 0, at_s
