"""A component's heartbeat on the bus."""

import threading
from collections.abc import Callable

from cairn.bus.bus import Node, full_name
from cairn.bus.qos import LATCHED
from cairn.schemas.cairn_msgs import ComponentStatus

TOPIC = "component_status"


class StatusPublisher:
    """Publishes a component's status, latched; from the component's thread and its host's."""

    def __init__(self, node: Node, robot: str, status: Callable[[], ComponentStatus]) -> None:
        self._publisher = node.advertise(full_name(robot, TOPIC), ComponentStatus, LATCHED)
        self._status = status
        self._lock = threading.Lock()
        self._open = True

    def publish(self) -> None:
        """Publish the status as it is now."""
        with self._lock:
            if self._open:
                self._publisher.publish(self._status())

    def close(self) -> None:
        """Publish no more."""
        with self._lock:
            self._open = False


def wire_text(text: str) -> str:
    """Any text as a message can hold it: without NUL, and of characters that UTF-8 has."""
    return text.replace("\0", "?").encode("utf-8", "replace").decode()
