"""Services over Zenoh as rmw_zenoh has them: a call is a query, its answer the reply.

A server is a complete queryable at the key of its service, whose last part is the type hash: calls
of another definition never reach it. A query ends without a reply when the process of its server
ends, so that a client learns of it at once. A server that does not take a call says why by
an error reply, which ROS 2 clients log.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import zenoh

from cairn.bus import keys
from cairn.bus.bus import OnFailure, OnReply, Post, ServerOptions, ServiceError, check_response
from cairn.bus.channels import ChannelReader
from cairn.bus.codec import Codec
from cairn.bus.message_limits import (
    PENDING_BYTES,
    default_max_bytes,
    is_bulk,
    ring_length,
)
from cairn.bus.qos import SERVICES
from cairn.bus.reply_thread import ReplyThread
from cairn.schemas.message import InvalidMessage, Service, type_name
from cairn.system.bell import Bell

if TYPE_CHECKING:
    from cairn.bus.zenoh_bus import ZenohNode

MOST_PENDING: Final = 1000
"""Calls of one server that wait until its component takes them; further ones are refused."""

_RING: Final = 2048  # calls that wait until they are read; Zenoh's ring takes 770 bytes for each
_PRIVATE_RING: Final = 256
_LONGEST_REASON: Final = 1000
_REPLIES: Final = 16  # of several servers of one name; Zenoh's thread waits for room for more
_LONGEST_WAIT_S: Final = 60.0
_LONGEST_SLEEP_S: Final = 3600.0
_LAST_ANSWERS_S: Final = 0.5
_SMALL: Final = 16 << 10  # bytes
_MANY_REPLIES: Final = "too many answers wait to be sent; call again later"


class ZenohServer:
    """Receives the calls of one service; keeps them in order until the component takes them."""

    def __init__(self, node: "ZenohNode", options: ServerOptions) -> None:
        name, service, wake, max_bytes, invalid_response, is_private = options
        self.received = 0
        self.invalid = 0
        self.refused = 0
        self._request, self._response = service.Request, service.Response
        self.name = name
        self._node = node.name
        self._codec = node.bus.codec
        self._wake = wake
        self._invalid_response = invalid_response
        self._max_bytes = max_bytes
        self._pending = _PendingQueries()
        self._replies = ReplyThread(f"{name.rpartition('/')[2]} replies")
        if not is_private:  # those of every node are rarely called: their codecs would take memory
            for cls in (self._request, self._response):
                self._codec.register(cls)
        self._announcement = node.announce("SS", name, service, SERVICES)
        self._closed = False
        key = self._announcement.key
        self._queries: ChannelReader | None = None
        self._private: PrivateQueries | None = None
        if is_private:
            self._private = node.private_queries(name, service)
            self._private.add(key, self._receive)
        else:
            ring = ring_length(_RING, self._max_bytes)
            self._queries = _reader(node.bus.session, key, ring, self._receive)

    def take(self) -> "ZenohCall | None":
        """Remove and return the oldest pending call; None if there is none.

        Raises `InvalidMessage` if its request is not valid; the client has its answer then.
        """
        query = self._pending.take()
        if query is None:
            return None
        call = ZenohCall(
            query, self._codec, self._response, self._replies, has_backlog=self._pending.is_waiting
        )
        payload = query.payload
        try:
            call.request = self._codec.decode(
                self._request, b"" if payload is None else payload.to_bytes()
            )
        except InvalidMessage as error:
            self.invalid += 1
            if self._invalid_response is not None:
                call.reply(self._invalid_response)
            else:
                call.refuse(f"{self.name}: invalid request: {error}")
            raise
        self.received += 1
        return call

    def close(self) -> None:
        """Stop serving; the pending calls are refused."""
        if self._closed:
            return
        self._closed = True
        if self._queries is not None:
            self._queries.close()
        if self._private is not None:
            self._private.remove(self._announcement.key)
        while (query := self._pending.take()) is not None:
            why = f"{self.name}: {self._node} does not serve it any more"
            self._replies.send(partial(_refuse, query, why), 0)
            del query
        self._replies.close()
        self._announcement.close()

    def _receive(self, query: zenoh.Query) -> None:
        """Keep a query until the component takes it; on the thread of the queryable."""
        payload = query.payload
        size = 0 if payload is None else len(payload)
        if size > self._max_bytes:  # before it is copied
            self.refused += 1
            _refuse(
                query,
                f"{self.name}: a request of {size:,} bytes; {self._node} accepts at most "
                f"{self._max_bytes:,}",
            )
        elif self._pending.put(query, size):
            self._wake()
        else:
            self.refused += 1
            _refuse(query, f"{self.name}: busy: too many calls wait already; call again later")


def _reader(
    session: zenoh.Session, key: str, ring: int, receive: Callable[[zenoh.Query], None]
) -> ChannelReader:
    """Read the queries of a key on a thread of its own, so that Zenoh's thread never waits."""
    queryable: Any = session.declare_queryable(key, zenoh.handlers.RingChannel(ring), complete=True)
    return ChannelReader(queryable, receive, key.split("/")[1])


class PrivateQueries:
    """Reads the queries of several services of a node on one thread."""

    def __init__(self, session: zenoh.Session, key_expression: str) -> None:
        """Read the queries of the services whose keys are added."""
        self._receivers: dict[str, Callable[[zenoh.Query], None]] = {}
        self._queries = _reader(session, key_expression, _PRIVATE_RING, self._dispatch)

    def add(self, key: str, receive: Callable[[zenoh.Query], None]) -> None:
        """Call `receive` with each query of a key from now on."""
        self._receivers[key] = receive

    def remove(self, key: str) -> None:
        """Leave the queries of a key without an answer."""
        self._receivers.pop(key, None)

    def close(self) -> None:
        """Receive nothing more."""
        self._queries.close()

    def _dispatch(self, query: zenoh.Query) -> None:
        receive = self._receivers.get(str(query.key_expr))
        if receive is not None:  # otherwise another node's
            receive(query)


class _PendingQueries:
    """The queries that wait for the component, within bounds; for two threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queries: deque[tuple[zenoh.Query, int]] = deque()
        self._bytes = 0
        self.is_waiting = False
        """Whether there is a query."""

    def put(self, query: zenoh.Query, size: int) -> bool:
        """Add a query with a payload of that size [bytes]; return False if there are too many."""
        with self._lock:
            if len(self._queries) >= MOST_PENDING or self._bytes + size > PENDING_BYTES:
                return False
            self._queries.append((query, size))
            self._bytes += size
            self.is_waiting = True
            return True

    def take(self) -> zenoh.Query | None:
        """Remove and return the oldest query; None if there is none."""
        with self._lock:
            if not self._queries:
                return None
            query, size = self._queries.popleft()
            self._bytes -= size
            self.is_waiting = bool(self._queries)
            return query


class ZenohCall:
    """One call of a service, which is answered now or later, once."""

    request: Any

    def __init__(
        self,
        query: zenoh.Query,
        codec: Codec,
        response: type[Any],
        replies: ReplyThread,
        *,
        has_backlog: bool,
    ) -> None:
        self._query: zenoh.Query | None = query
        self._replies = replies
        self._has_backlog = has_backlog
        self._codec = codec
        self._response = response
        attachment = keys.Attachment.of(query)
        self.client = bytes(16) if attachment is None else attachment.gid
        self.sequence = 0 if attachment is None else attachment.sequence

    def reply(self, response: Any) -> None:
        """Answer with a message of the service's response class; `TypeError` for another one."""
        check_response(response, self._response)
        payload = self._codec.encode(response)
        query, self._query = self._query, None
        if query is None:
            return
        attachment = keys.plain_attachment(self.sequence, time.time_ns(), self.client)
        # Calls that come one by one are of clients that read; another thread would slow them down.
        if not self._has_backlog and not self._replies.unsent and len(payload) <= _SMALL:
            _answer(query, payload, attachment)
        elif not self._replies.send(partial(_answer, query, payload, attachment), len(payload)):
            self._replies.send(partial(_refuse, query, _MANY_REPLIES), 0)

    def refuse(self, reason: str) -> None:
        """Answer with an error."""
        query, self._query = self._query, None
        if query is not None:
            self._replies.send(partial(_refuse, query, reason), 0)


class ZenohClient:
    """Calls one service; from its component's calls, or from any thread of a script."""

    def __init__(
        self,
        session: zenoh.Session,
        codec: Codec,
        name: str,
        key: str,
        gid: bytes,
        service: type[Service[Any, Any]],
        post: Post,
        deliver: Post,
        on_close: Callable[[], None] = lambda: None,
        on_available: Callable[[], None] = lambda: None,
    ) -> None:
        """Call the service `name` at its key; `gid` is the identity of this client.

        `on_available` is called on Zenoh's thread when there is a server.
        """
        self._on_close = on_close
        self._on_available = on_available
        self.sent = 0
        request, self._response = service.Request, service.Response
        self.name = name
        self._key = key
        self.gid = gid
        self._max_bytes = default_max_bytes(self._response)
        self._post = post
        self._waiter = _Waiter(name, deliver)
        self._cancellation = zenoh.CancellationToken()
        self._gone: list[zenoh.CancellationToken] = []  # of calls to servers that have just gone
        self._gone_lock = threading.Lock()
        self._codec = codec
        self._session = session
        bulk = is_bulk(request) or is_bulk(self._response)
        self._options: dict[str, Any] = {
            "target": zenoh.QueryTarget.ALL_COMPLETE,
            "consolidation": zenoh.ConsolidationMode.NONE,
            "encoding": zenoh.Encoding.APPLICATION_CDR.with_schema(type_name(request)),
            # A request that is lost would be an answer that never arrives.
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "priority": zenoh.Priority.DATA_LOW if bulk else zenoh.Priority.INTERACTIVE_HIGH,
        }
        self._pending: set[_PendingCall] = set()
        self._closed = False
        self._is_matched = False  # as the listener knows
        self._querier = session.declare_querier(key, target=zenoh.QueryTarget.ALL_COMPLETE)
        on_change = zenoh.handlers.Callback(self._matching_changed, indirect=False)
        self._listener: Any = self._querier.declare_matching_listener(on_change)

    @property
    def is_available(self) -> bool:
        """Whether there is a server, as far as this process knows."""
        status: Any = self._querier.matching_status
        return not self._closed and bool(status.matching)

    def call(
        self, request: Any, on_reply: OnReply, on_failure: OnFailure, timeout_s: float
    ) -> None:
        """Send a request; never waits for the answer.

        Exactly one of the functions is called later, through `post`: with the response, or with
        what prevented it. After `close`, neither is.
        """
        if self._closed:
            return
        self.sent += 1
        call = _PendingCall(self, on_reply, on_failure, timeout_s)
        self._pending.add(call)
        cancellation = self._cancellation  # of the server that there is now
        if not (self._is_matched or self.is_available):
            call.fail(ServiceError(f"{self.name}: there is no server of this type"))
            return
        # Zenoh's thread wakes the waiter without Python, which takes half as long as a call of
        # Python does. One that waits long would keep it from others.
        waits = timeout_s <= _LONGEST_WAIT_S and self._waiter.reserve()
        handler: Any = (
            zenoh.handlers.FifoChannel(_REPLIES)
            if waits
            else zenoh.handlers.Callback(call.on_reply, call.on_end, indirect=False)
        )
        try:
            replies = self._session.get(
                self._key,
                handler,
                payload=self._codec.encode(request),
                attachment=keys.plain_attachment(self.sent, time.time_ns(), self.gid),
                timeout=timeout_s,
                cancellation_token=cancellation,
                **self._options,
            )
        except zenoh.ZError as error:
            if waits:
                self._waiter.release()
            call.fail(ServiceError(f"{self.name}: the request cannot be sent: {error}"))
        else:
            if waits:
                self._waiter.wait_for(call, replies)

    def close(self) -> None:
        """Stop calling: answers that arrive later are ignored."""
        if self._closed:
            return
        self._closed = True
        self._pending.clear()
        self._waiter.close()
        self._cancellation.cancel()
        self._listener.undeclare()
        self._querier.undeclare()
        self._on_close()

    def finish(self, call: "_PendingCall", done: Callable[[], None]) -> None:
        """Post the end of a call, unless it has ended, or this client was closed."""
        try:
            self._pending.remove(call)
        except KeyError:
            return
        if self._waiter.thread_id == threading.get_ident():
            self._waiter.deliver(done)
        else:
            self._post(done)

    def _matching_changed(self, status: Any) -> None:
        """Report a server; end the calls that wait for the last one soon after it has gone.

        Zenoh 1.10 does not end a query that it sends while it closes the connection to the server.
        """
        self._is_matched = status.matching
        if status.matching:
            self._on_available()
        if status.matching or self._closed or not self._pending:
            return
        with self._gone_lock:
            self._gone.append(self._cancellation)
            self._cancellation = zenoh.CancellationToken()
            if len(self._gone) > 1:  # a server that comes and goes does not start many timers
                return
        # The last answers may arrive later than the news that the server has gone.
        timer = threading.Timer(_LAST_ANSWERS_S, self._cancel_gone)
        timer.daemon = True
        timer.start()

    def _cancel_gone(self) -> None:
        with self._gone_lock:
            gone, self._gone = self._gone, []
        for token in gone:
            token.cancel()

    def decoded(self, payload: zenoh.ZBytes) -> Any:
        """Return a response; raises `ServiceError` if it is not valid."""
        if len(payload) > self._max_bytes:  # before it is copied
            raise ServiceError(
                f"{self.name}: a response of {len(payload):,} bytes, more than the "
                f"{self._max_bytes:,} that are accepted"
            )
        try:
            return self._codec.decode(self._response, payload.to_bytes())
        except InvalidMessage as error:
            raise ServiceError(f"{self.name}: invalid response: {error}") from error


class _Waiter:
    """A thread that waits for the answer to one call of a client at a time."""

    def __init__(self, name: str, deliver: Post) -> None:
        self.deliver = deliver
        """Hands the answer to the component; this thread may make the call itself."""
        self.thread_id = 0
        """Identifier of its thread, 0 before it has one."""
        self._name = name
        self._bell = Bell()
        self._free = threading.Lock()
        self._job: tuple[_PendingCall, Any] | None = None
        self._thread: threading.Thread | None = None
        self._closed = False

    def reserve(self) -> bool:
        """Return whether it is free, and reserved for the next call now."""
        return self._free.acquire(blocking=False)

    def release(self) -> None:
        """Make it free again."""
        self._free.release()

    def wait_for(self, call: "_PendingCall", replies: Any) -> None:
        """Wait for the replies to a call, for which it was reserved."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        self._job = (call, replies)
        self._bell.ring()

    def close(self) -> None:
        """End the thread, after the call for which it waits."""
        self._closed = True
        self._bell.ring()

    def _run(self) -> None:
        self.thread_id = threading.get_ident()
        while True:
            self._bell.wait(_LONGEST_SLEEP_S)
            job, self._job = self._job, None
            if job is not None:
                self._wait(*job)
            if self._closed and self._job is None:
                return

    def _wait(self, call: "_PendingCall", replies: Any) -> None:
        """Hand over the first answer; be free for the next call before that is handled."""
        answered = False
        while True:
            try:
                reply = replies.recv()
            except zenoh.ZError:  # there are no more
                break
            if reply.ok is not None and not answered:
                answered = True
                self._free.release()
            call.on_reply(reply)
            if answered:
                return
        self._free.release()
        call.on_end()


class _PendingCall:
    """A call whose answer has not arrived; Zenoh's threads call its methods."""

    def __init__(
        self, client: ZenohClient, on_reply: OnReply, on_failure: OnFailure, timeout_s: float
    ) -> None:
        self._client = client
        self._on_reply = on_reply
        self._on_failure = on_failure
        self._timeout_s = timeout_s
        self._start = time.monotonic()
        self._refusal: zenoh.ZBytes | None = None

    def on_reply(self, reply: zenoh.Reply) -> None:
        """Note a reply; the first one that is not an error ends the call."""
        if reply.ok is not None:
            self._client.finish(self, partial(self._deliver, reply.ok.payload))
        elif reply.err is not None:
            self._refusal = reply.err.payload

    def on_end(self) -> None:
        """End the call if no server has answered."""
        self._client.finish(self, self._fail)

    def fail(self, error: ServiceError) -> None:
        """End the call."""
        self._client.finish(self, partial(self._on_failure, error))

    def _deliver(self, payload: zenoh.ZBytes) -> None:
        try:
            response = self._client.decoded(payload)
        except ServiceError as error:
            self._on_failure(error)
        else:
            self._on_reply(response)

    def _fail(self) -> None:
        name = self._client.name
        if time.monotonic() - self._start >= self._timeout_s:
            error = f"{name}: no answer within {self._timeout_s:g} s"
        elif self._refusal is not None:
            data = self._refusal.to_bytes()[: 4 * _LONGEST_REASON]
            error = data.decode(errors="replace")[:_LONGEST_REASON]
        else:
            error = f"{name}: no answer: the server ended, or has too many calls; call again later"
        self._on_failure(ServiceError(error))


def _answer(query: zenoh.Query, payload: bytes, attachment: bytes) -> None:
    with query:
        try:
            query.reply(query.key_expr, payload, attachment=attachment)
        except zenoh.ZError:  # the client may have ended
            return


def _refuse(query: zenoh.Query, reason: str) -> None:
    with query, suppress(zenoh.ZError):  # the client may have ended
        query.reply_err(reason[:_LONGEST_REASON].encode())
