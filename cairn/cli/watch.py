"""Feeds a view from the bus of a running deployment: logs, statuses, time."""

from collections.abc import Callable
from typing import Any

from cairn.bus.bus import Bus, Subscription, full_name
from cairn.bus.qos import LATCHED, Qos
from cairn.cli.view import View
from cairn.clock import to_ns
from cairn.component.clock_input import TOPIC as CLOCK
from cairn.component.rosout import KEPT, ROSOUT
from cairn.component.status import TOPIC as STATUS
from cairn.deployment.model import VIEW
from schemas.cairn_msgs import ComponentStatus
from schemas.message import InvalidMessage
from schemas.rcl_interfaces import Log
from schemas.rosgraph_msgs import Clock


class Watch:
    """Reads what a view shows, as one more node of the deployment."""

    def __init__(
        self,
        bus: Bus,
        robot: str,
        view: View,
        *,
        clock: bool,
        hurry: Callable[[], None] | None = None,
    ) -> None:
        """`clock`: time is simulated, on topic `clock`.

        Log messages are read from /rosout if `hurry` is given, which asks for a `refresh` soon.
        """
        self._view = view
        self._robot = robot
        self._hurry = hurry
        self._hurried = False
        node = bus.node(full_name(robot, VIEW), lambda _: None)
        newest = Qos("reliable", "volatile", 1)
        self._sources: list[tuple[Subscription, Callable[[Any], None]]] = [
            self._source(node, full_name(robot, STATUS), ComponentStatus, LATCHED.with_depth(1000),
                         view.status, _not_woken),
        ]  # fmt: skip
        if clock:
            self._sources.append(
                self._source(node, full_name(robot, CLOCK), Clock, newest,
                             lambda told: view.time(to_ns(told.clock)), _not_woken)
            )  # fmt: skip
        if hurry is not None:
            self._sources.append(self._source(node, ROSOUT, Log, KEPT, self._log, self._wake))

    def refresh(self) -> None:
        """Pass on all that has come, then have the view drawn."""
        self._hurried = False
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

    def _source(
        self,
        node: Any,
        topic: str,
        message: type[Any],
        qos: Qos,
        show: Callable[[Any], None],
        wake: Callable[[], None],
    ) -> tuple[Subscription, Callable[[Any], None]]:
        return node.subscribe(topic, message, qos, wake), show

    def _wake(self) -> None:
        if self._hurry is not None and not self._hurried:
            self._hurried = True
            self._hurry()

    def _log(self, entry: Log) -> None:
        if entry.name.startswith(f"{self._robot}."):
            self._view.log(entry)


def _not_woken() -> None:
    """These wait until the next refresh."""
