"""What is published of the calls of one service: its introspection, as rcl has it.

Server and clients publish on `<service>/_service_event`, a message of type `<Service>_Event` for
each request and response that is sent or received (`rcl/service_introspection.h`, REP 2012). By
client and sequence number, a tool finds the events of one call.
"""

from typing import Any

import numpy as np

from cairn.bus.bus import Node, Publisher
from cairn.bus.qos import RELIABLE
from cairn.runtime.parameters import ServiceIntrospection
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.message import Service
from cairn.schemas.service_msgs.msg import ServiceEventInfo
from cairn.system.clock import Clock

SERVICE_EVENT_TOPIC = "_service_event"
"""Name of the topic below that of the service."""

_REQUESTS = (ServiceEventInfo.REQUEST_SENT, ServiceEventInfo.REQUEST_RECEIVED)


class ServiceEvents:
    """Publishes the events of one server or client, if that is switched on and anything listens."""

    def __init__(
        self, name: str, service: type[Service[Any, Any]], node: Node, clock: Clock
    ) -> None:
        """Publish nothing yet.

        Args:
            name: full name of the service.
            service: its type.
            node: the node that serves or calls.
            clock: gives the stamps.
        """
        self._topic = f"{name}/{SERVICE_EVENT_TOPIC}"
        self._service = service
        self._node = node
        self._clock = clock
        self.are_on = False
        """Whether they are switched on: read for every call."""
        self._publisher: Publisher | None = None
        self._with_contents = False

    @property
    def are_received(self) -> bool:
        """Whether an event would be received."""
        return self._publisher is not None and self._publisher.has_subscribers

    def configure(self, introspection: ServiceIntrospection) -> None:
        """Choose what is published: nothing, who called when, or also requests and responses."""
        self.are_on = introspection != "off"
        self._with_contents = introspection == "contents"
        if self._publisher is not None and not self.are_on:
            self._publisher.close()
            self._publisher = None
        elif self._publisher is None and self.are_on:
            self._publisher = self._node.advertise(
                self._topic, self._service.Event, RELIABLE, shared=True
            )

    def publish(self, event_type: int, client: bytes, sequence: int, content: Any) -> None:
        """Publish an event of `ServiceEventInfo`, of a request or response, if it is wanted.

        `client` is the client's identity (16 bytes) and `sequence` the number of its call.
        """
        if self._publisher is None or not self._publisher.has_subscribers:
            return
        info = ServiceEventInfo(
            event_type=event_type,
            stamp=from_ns(self._clock.now()),
            client_gid=np.frombuffer(client, np.uint8),
            sequence_number=sequence,
        )
        contents = (content,) if self._with_contents else ()
        side = "request" if event_type in _REQUESTS else "response"
        self._publisher.publish(self._service.Event(info=info, **{side: contents}))
