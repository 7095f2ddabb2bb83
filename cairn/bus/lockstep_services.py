"""Services in memory: calls are handed over as objects, in order, for lockstep runs and tests."""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from cairn.bus import keys
from cairn.bus.bus import (
    ClientOptions,
    OnFailure,
    OnReply,
    ServerOptions,
    ServiceError,
    check_response,
)
from cairn.bus.conflicts import type_conflict
from cairn.bus.message_limits import length_of
from cairn.bus.services import MOST_PENDING
from cairn.schemas.message import type_name
from cairn.system.clock import SECOND

if TYPE_CHECKING:
    from cairn.bus.lockstep_bus import LockstepBus, LockstepNode


class LockstepServer:
    """Receives the calls of one service in memory."""

    def __init__(self, node: "LockstepNode", options: ServerOptions) -> None:
        self.node = node
        self.name = options.name
        self.service = options.service
        self.received = 0
        self.invalid = 0
        self.refused = 0
        self._max_bytes = options.max_bytes
        self._wake = options.wake
        self._pending: deque[LockstepCall] = deque()
        self._servers = node.bus.servers.setdefault(self.name, [])
        for other in self._servers:
            report_conflict(self.name, node, self.service, other.node, other.service, "service")
        self._servers.append(self)

    def take(self) -> "LockstepCall | None":
        """Remove and return the oldest pending call; None if there is none."""
        if not self._pending:
            return None
        self.received += 1
        return self._pending.popleft()

    def put(self, call: "LockstepCall") -> None:
        """Add a pending call and wake the server, or refuse it."""
        size = length_of(call.request)
        if size > self._max_bytes or len(self._pending) >= MOST_PENDING:
            self.refused += 1
            why = "too many calls wait already" if size <= self._max_bytes else f"{size:,} bytes"
            call.refuse(f"{self.name}: refused by {self.node.name}: {why}")
            return
        self._pending.append(call)
        self._wake()

    def close(self) -> None:
        """Stop serving; the pending calls are refused."""
        if self in self._servers:
            self._servers.remove(self)
        while self._pending:
            reason = f"{self.name}: {self.node.name} does not serve it any more"
            self._pending.popleft().refuse(reason)


class LockstepCall:
    """One call in memory."""

    def __init__(self, client: "LockstepClient", request: Any, end: Callable[[Any], None]) -> None:
        self.request = request
        self.client = client.gid
        self.sequence = client.sent
        self._response: type[Any] = client.service.Response
        self._end: Callable[[Any], None] | None = end

    def reply(self, response: Any) -> None:
        """Answer with a message of the service's response class; `TypeError` for another one."""
        check_response(response, self._response)
        self._finish(response)

    def refuse(self, reason: str) -> None:
        """Answer with an error."""
        self._finish(ServiceError(reason))

    def _finish(self, outcome: Any) -> None:
        end, self._end = self._end, None
        if end is not None:
            end(outcome)


class LockstepClient:
    """Calls one service in memory."""

    def __init__(self, node: "LockstepNode", options: ClientOptions) -> None:
        self.node = node
        self.name = options.name
        self.service = options.service
        self.sent = 0
        self.gid = keys.gid(f"{node.name} {self.name} client")
        self._bus: LockstepBus = node.bus
        self._post = options.post
        self._closed = False
        for server in self._bus.servers.get(self.name, ()):
            report_conflict(self.name, node, self.service, server.node, server.service, "service")

    @property
    def is_available(self) -> bool:
        """Whether there is a server."""
        return not self._closed and self._server() is not None

    def call(
        self, request: Any, on_reply: OnReply, on_failure: OnFailure, timeout_s: float
    ) -> None:
        """Hand over a request; one of the functions is posted later."""
        if self._closed:
            return
        self.sent += 1
        ended = False

        def end(outcome: Any) -> None:
            nonlocal ended
            if ended or self._closed:
                return
            ended = True
            done = on_failure if isinstance(outcome, ServiceError) else on_reply
            self._post(partial(done, outcome))

        server = self._server()
        if server is None:
            end(ServiceError(f"{self.name}: there is no server of this type"))
            return
        late = ServiceError(f"{self.name}: no answer within {timeout_s:g} s")
        self._bus.after(round(timeout_s * SECOND), lambda: end(late))
        server.put(LockstepCall(self, request, end))

    def close(self) -> None:
        """Stop calling."""
        self._closed = True

    def _server(self) -> LockstepServer | None:
        servers = self._bus.servers.get(self.name, ())
        return next((one for one in servers if one.service is self.service), None)


def report_conflict(
    name: str,
    first: "LockstepNode",
    ours: type[Any],
    second: "LockstepNode",
    theirs: type[Any],
    kind: Literal["topic", "service"] = "topic",
) -> None:
    """Report to both nodes that their types of one topic or service differ, if they do."""
    if ours is not theirs:
        one, other = type_name(ours), type_name(theirs)
        first.report(type_conflict(name, second.name, other, first.name, one, kind))
        second.report(type_conflict(name, first.name, one, second.name, other, kind))
