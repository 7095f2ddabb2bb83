"""The servers and clients of components: they answer and make calls of services, and count them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, Generic, Literal

from cairn.bus.bus import Call, OnFailure, ServiceClient, ServiceError, ServiceServer
from cairn.errors import CairnError
from cairn.runtime.call_log import CallLog
from cairn.runtime.call_records import RecordKind
from cairn.runtime.component import ComponentContext
from cairn.runtime.port import Port, check_max_bytes, type_of
from cairn.runtime.service_events import ServiceEvents
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import InvalidMessage, Request, Response, type_name
from cairn.schemas.service_msgs.msg import ServiceEventInfo


class Server(Port, Generic[Request, Response]):
    """A service that the component provides, while it is active.

    `save_map: Server[SaveMap.Request, SaveMap.Response]`; a method decorated `@serve("save_map")`
    answers its calls. A request longer than `max_bytes` is refused before it is decoded; the
    default limit follows from the type, as for `In`.
    """

    role: ClassVar[Literal["server"]] = "server"

    def __init__(self, *, max_bytes: int | None = None) -> None:
        check_max_bytes("Server", max_bytes)
        self.max_bytes = max_bytes
        self._server: ServiceServer | None = None
        # The server to count, and the counts before it; one tuple, read by other threads.
        self._counted: tuple[ServiceServer | None, tuple[int, int, int]] = (None, (0, 0, 0))

    @property
    def service(self) -> str:
        """The full name of the service in this deployment; `CairnError` on a declaration."""
        return self._bound_name()

    def bind(
        self,
        context: ComponentContext,
        service: str,
        where: str,
        answer: Callable[[Call], None],
        invalid_response: Any = None,
        after: "Sequence[Server[Any, Any]]" = (),
    ) -> None:
        """Bind the port to a service (full name).

        `answer` answers a call, now or later; an exception that it raises fails the component, and
        refuses the call; the status shows `where` that happens. `invalid_response` answers calls
        whose request is not valid. The calls of the servers `after` which this one comes are
        handled first.
        """
        self._bind(context, service)
        self.events = ServiceEvents(service, self.interface, context.node, context.unlogged_clock)
        self._where = where
        self._answer = answer
        self._invalid_response = invalid_response
        self._after = after
        self._wake = partial(context.scheduler.deliver, self._on_wake_up)

    def open(self) -> None:
        """Serve from now on."""
        if self._server is None:
            self._server = self._context.node.serve(
                self._full_name,
                self.interface,
                self._wake,
                self.max_bytes,
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
        return self._status(PortStatus.SERVER, received, invalid=invalid, refused=refused)

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
                self._context.log.error(
                    "service %s: refused an invalid request (%d so far): %s",
                    self._full_name, count, error,
                )  # fmt: skip
            return True
        if call is None:
            return False
        if self._call_log is not None:
            self._call_log.called(self.name, call)
            call = _LoggedCall(call, self.name, self._call_log)
        if self.events.are_on:
            self._publish_event(ServiceEventInfo.REQUEST_RECEIVED, call, call.request)
            call = _ObservedCall(call, self._publish_event)
        self._context.run(self._where, self._make, call)
        return True

    def _publish_event(self, event_type: int, call: Call, content: Any) -> None:
        self.events.publish(event_type, call.client, call.sequence, content)

    def _make(self, call: Call) -> None:
        try:
            self._answer(call)
        except BaseException:
            call.refuse(f"{self._full_name}: its server failed; its log has the reason")
            raise


class Client(Port, Generic[Request, Response]):
    """A service that the component calls, while it is active.

    `plan: Client[GetPlan.Request, GetPlan.Response]`. With `optional=True` the component works
    without a server, and the check of a deployment does not require one.
    """

    role: ClassVar[Literal["client"]] = "client"

    def __init__(self, *, optional: bool = False) -> None:
        self.optional = optional
        self._client: ServiceClient | None = None
        self._sent = 0

    @property
    def service(self) -> str:
        """The full name of the service in this deployment; `CairnError` on a declaration."""
        return self._bound_name()

    @property
    def is_available(self) -> bool:
        """Whether there is a server; `CairnError` on a declaration."""
        self._bound_name()
        client = self._client
        available = client is not None and client.is_available
        self._log_presence(available)
        return available

    def call(
        self,
        request: Request,
        on_response: Callable[[Response], None],
        on_failure: OnFailure | None = None,
        *,
        timeout_s: float = 5.0,
    ) -> None:
        """Call the service, without waiting: one of the functions is called later as a handler.

        `on_failure` gets the reason if there is no server, it ends, refuses the call, or does not
        answer within the time limit; without it, the reason is logged as a warning. A component
        that becomes inactive gets no answer any more. Raises `CairnError` if the request is of
        another type than the port's, or on a declaration.
        """
        self._bound_name()
        if not isinstance(request, self.interface.Request):
            raise CairnError(
                f"{self._context.name}: port {self.name} calls {type_name(self.interface)}, "
                f"whose request is not {type_of(request)}"
            )
        if self._client is None:
            return
        self._sent += 1
        sequence = self._sent
        if self._call_log is not None:
            content = self._call_log.codec.encode(request)
            self._call_log.add(RecordKind.REQUESTED, self.name, sequence, content)
        take: Callable[[Any], None] = partial(self._on_answer, sequence, on_response)
        if self.events.are_on:
            call = (self._client.gid, self._client.sent + 1)
            take = partial(self._on_observed_response, call, take)
            self.events.publish(ServiceEventInfo.REQUEST_SENT, *call, request)
        self._client.call(
            request,
            take,
            partial(self._on_answer, sequence, on_failure or self._log_failure),
            timeout_s,
        )

    def bind(self, context: ComponentContext, service: str) -> None:
        """Bind the port to a service (full name)."""
        self._bind(context, service)
        self.events = ServiceEvents(service, self.interface, context.node, context.unlogged_clock)

    def open(self) -> None:
        """Call from now on."""
        if self._client is None:
            self._client = self._context.node.client(
                self._full_name,
                self.interface,
                self._context.scheduler.receive,
                self._context.scheduler.deliver,
            )

    def close(self) -> None:
        """Call no more, and take no answers."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def status(self) -> PortStatus:
        """Return the counters."""
        return self._status(PortStatus.CLIENT, self._sent)

    def _on_observed_response(
        self, call: tuple[bytes, int], handle: Callable[[Any], None], response: Any
    ) -> None:
        self.events.publish(ServiceEventInfo.RESPONSE_RECEIVED, *call, response)
        handle(response)

    def _on_answer(self, sequence: int, handle: Callable[[Any], None], answer: Any) -> None:
        if self._call_log is not None:
            self._call_log.answered(self.name, sequence, answer)
        where = f"{getattr(handle, '__name__', 'answer')} (service {self.name})"
        self._context.run(where, handle, answer)

    def _log_failure(self, error: ServiceError) -> None:
        self._context.log.warning("a call of %s failed: %s", type_name(self.interface), error)


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


class _WrappedCall:
    """A call whose answer has further effects."""

    def __init__(self, call: Call) -> None:
        self._call = call
        self.request = call.request
        self.client = call.client
        self.sequence = call.sequence

    def refuse(self, reason: str) -> None:
        self._call.refuse(reason)


class _LoggedCall(_WrappedCall):
    """A call whose answer is logged."""

    def __init__(self, call: Call, port: str, log: CallLog) -> None:
        super().__init__(call)
        self._port = port
        self._log = log

    def reply(self, response: Any) -> None:
        self._call.reply(response)
        content = self._log.codec.encode(response)
        self._log.add(RecordKind.REPLIED, self._port, self.client, self.sequence, content)

    def refuse(self, reason: str) -> None:
        super().refuse(reason)
        self._log.add(RecordKind.REFUSED, self._port, self.client, self.sequence, reason)


class _ObservedCall(_WrappedCall):
    """A call whose answer is published as an event."""

    def __init__(self, call: Call, publish: Callable[[int, Call, Any], None]) -> None:
        super().__init__(call)
        self._publish = publish

    def reply(self, response: Any) -> None:
        self._call.reply(response)
        self._publish(ServiceEventInfo.RESPONSE_SENT, self._call, response)
