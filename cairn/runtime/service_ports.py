"""The servers and clients of one running component: they answer and call, and count."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from cairn.bus.bus import Call, Client, Node, Server, ServiceError
from cairn.errors import CairnError
from cairn.runtime.call_log import CallLog
from cairn.runtime.call_records import RecordKind
from cairn.runtime.loop import Scheduler
from cairn.runtime.port_owner import PortOwner
from cairn.runtime.ports import BoundClient, BoundServer, ServiceSpec
from cairn.runtime.service_events import ServiceEvents
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.service_msgs.msg import ServiceEventInfo


class ServerPort:
    """A server of the component."""

    def __init__(
        self,
        spec: ServiceSpec,
        service: str,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        where: str,
        answer: Callable[[Call], None],
        call_log: CallLog | None,
        invalid_response: Any = None,
        after: "Sequence[ServerPort]" = (),
    ) -> None:
        """Prepare the server of the service of that full name.

        `answer` answers a call, now or later; an exception that it raises fails the component, and
        refuses the call. `invalid_response` answers calls whose request is not valid. The calls of
        the servers `after` which this one comes are handled first.
        """
        self.bound: BoundServer[Any, Any] = BoundServer(spec, service)
        self.events = ServiceEvents(service, spec.service, node, owner.unlogged_clock)
        self._spec = spec
        self._owner = owner
        self._node = node
        self._where = where
        self._answer = answer
        self._call_log = call_log
        self._invalid_response = invalid_response
        self._after = after
        self._wake = partial(scheduler.deliver, self._on_wake_up)
        self._server: Server | None = None
        # The server to count, and the counts before it; one tuple, read by other threads.
        self._counted: tuple[Server | None, tuple[int, int, int]] = (None, (0, 0, 0))

    def open(self) -> None:
        """Serve from now on."""
        if self._server is None:
            self._server = self._node.serve(
                self.bound.service,
                self._spec.service,
                self._wake,
                self._spec.max_bytes,
                self._invalid_response,
            )
            self._counted = (self._server, self._counted[1])

    def close(self) -> None:
        """Stop serving; refuse the pending calls."""
        if self._server is not None:
            self._server.close()
            self._server = None
            self._counted = (None, self._counts())

    def status(self) -> PortStatus:
        """Return the counters."""
        received, invalid, refused = self._counts()
        return PortStatus(
            port=self._spec.name,
            topic=self.bound.service,
            direction=PortStatus.SERVER,
            messages=received,
            invalid=invalid,
            refused=refused,
        )

    def _counts(self) -> tuple[int, int, int]:
        now, before = self._counted
        if now is None:
            return before
        return before[0] + now.received, before[1] + now.invalid, before[2] + now.refused

    def _on_wake_up(self) -> None:
        for other in self._after:
            while other.handle_next():
                pass
        self.handle_next()

    def handle_next(self) -> bool:
        """Handle the oldest pending call; return whether there was one."""
        if self._server is None:
            return False
        try:
            call = self._server.take()
        except InvalidMessage as error:
            count = self._counts()[1]
            if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ... do not flood the log
                self._owner.log.error(
                    "service %s: refused an invalid request (%d so far): %s",
                    self.bound.service, count, error,
                )  # fmt: skip
            return True
        if call is None:
            return False
        if self._call_log is not None:
            self._call_log.called(self._spec.name, call)
            call = _LoggedCall(call, self._spec.name, self._call_log)
        if self.events.are_on:
            self._publish_event(ServiceEventInfo.REQUEST_RECEIVED, call, call.request)
            call = _ObservedCall(call, self._publish_event)
        self._owner.run(self._where, self._make, call)
        return True

    def _publish_event(self, event_type: int, call: Call, content: Any) -> None:
        self.events.publish(event_type, call.client, call.sequence, content)

    def _make(self, call: Call) -> None:
        try:
            self._answer(call)
        except BaseException:
            call.refuse(f"{self.bound.service}: its server failed; its log has the reason")
            raise


def answering(method: Callable[[Any], Any], service: str) -> Callable[[Call], None]:
    """Return a function that answers calls by what a method returns or raises."""

    def answer(call: Call) -> None:
        try:
            response = method(call.request)
        except InvalidMessage:
            raise
        except CairnError as error:
            call.refuse(f"{service}: {error}")
            return
        try:
            call.reply(response)
        except TypeError as error:
            raise CairnError(f"service {service}: {error}") from error

    return answer


class _LoggedCall:
    """A call whose answer is logged."""

    def __init__(self, call: Call, port: str, log: CallLog) -> None:
        self._call = call
        self._port = port
        self._log = log
        self.request = call.request
        self.client = call.client
        self.sequence = call.sequence

    def reply(self, response: Any) -> None:
        self._call.reply(response)
        content = self._log.codec.encode(response)
        self._log.add(RecordKind.REPLIED, self._port, self.client, self.sequence, content)

    def refuse(self, reason: str) -> None:
        self._call.refuse(reason)
        self._log.add(RecordKind.REFUSED, self._port, self.client, self.sequence, reason)


class _ObservedCall:
    """A call whose answer is published as an event."""

    def __init__(self, call: Call, publish: Callable[[int, Call, Any], None]) -> None:
        self._call = call
        self._publish = publish
        self.request = call.request
        self.client = call.client
        self.sequence = call.sequence

    def reply(self, response: Any) -> None:
        self._call.reply(response)
        self._publish(ServiceEventInfo.RESPONSE_SENT, self._call, response)

    def refuse(self, reason: str) -> None:
        self._call.refuse(reason)


class ClientPort:
    """A client of the component."""

    def __init__(
        self,
        component: str,
        spec: ServiceSpec,
        service: str,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        call_log: CallLog | None,
    ) -> None:
        """Prepare the client of the service of that full name."""
        self.bound: BoundClient[Any, Any] = BoundClient(
            component, spec, service, self._call, self._is_available
        )
        self.events = ServiceEvents(service, spec.service, node, owner.unlogged_clock)
        self._spec = spec
        self._owner = owner
        self._node = node
        self._scheduler = scheduler
        self._call_log = call_log
        self._client: Client | None = None
        self._sent = 0

    def open(self) -> None:
        """Call from now on."""
        if self._client is None:
            self._client = self._node.client(
                self.bound.service,
                self._spec.service,
                self._scheduler.receive,
                self._scheduler.deliver,
            )

    def close(self) -> None:
        """Call no more, and take no answers."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def status(self) -> PortStatus:
        """Return the counters."""
        return PortStatus(
            port=self._spec.name,
            topic=self.bound.service,
            direction=PortStatus.CLIENT,
            messages=self._sent,
        )

    def _is_available(self) -> bool:
        client = self._client
        available = client is not None and client.is_available
        if self._call_log is not None:
            kind = RecordKind.HAS_SUBSCRIBERS if available else RecordKind.NO_SUBSCRIBERS
            self._call_log.add(kind, self._spec.name)
        return available

    def _call(
        self,
        request: Any,
        on_response: Callable[[Any], None],
        on_failure: Callable[[ServiceError], None] | None,
        timeout_s: float,
    ) -> None:
        if self._client is None:
            return
        self._sent += 1
        sequence = self._sent
        if self._call_log is not None:
            content = self._call_log.codec.encode(request)
            self._call_log.add(RecordKind.REQUESTED, self._spec.name, sequence, content)
        on_response = partial(self._on_answer, sequence, on_response)
        if self.events.are_on:
            call = (self._client.gid, self._client.sent + 1)
            on_response = partial(self._on_observed_response, call, on_response)
            self.events.publish(ServiceEventInfo.REQUEST_SENT, *call, request)
        self._client.call(
            request,
            on_response,
            partial(self._on_answer, sequence, on_failure or self._log_failure),
            timeout_s,
        )

    def _on_observed_response(
        self, call: tuple[bytes, int], handle: Callable[[Any], None], response: Any
    ) -> None:
        self.events.publish(ServiceEventInfo.RESPONSE_RECEIVED, *call, response)
        handle(response)

    def _on_answer(self, sequence: int, handle: Callable[[Any], None], answer: Any) -> None:
        if self._call_log is not None:
            self._call_log.answered(self._spec.name, sequence, answer)
        where = f"{getattr(handle, '__name__', 'answer')} (service {self._spec.name})"
        self._owner.run(where, handle, answer)

    def _log_failure(self, error: ServiceError) -> None:
        self._owner.log.warning("a call of %s failed: %s", type_name(self._spec.service), error)
