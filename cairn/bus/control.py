"""Control requests to components (life cycle, parameters, loading), apart from the topics.

A request is a query whose key names the component and the verb, and whose payload is JSON. Zenoh
ends a query without a reply whether the component does not exist, dies, or hangs; `request` turns
each of these into an error.

Requests and replies have limits, which both sides check before they decode them. So many requests
of one component wait at most; further ones are rejected at once, except urgent ones.
"""

import os
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from functools import partial
from types import MappingProxyType
from typing import Any

import zenoh
from pydantic import BaseModel, ConfigDict, Field

from cairn.bus.channels import ChannelReader
from cairn.bus.keys import control_key
from cairn.bus.message_limits import REPLY_BYTES, REQUEST_BYTES
from cairn.bus.reply_thread import ReplyThread
from cairn.errors import CairnError
from cairn.limits.json import parse_json, too_large

_VERB = re.compile(r"[a-z][a-z0-9_]{0,99}")
_DEFAULT_BYTES = 64 << 10
"""Longest request [bytes], unless the component declares another limit for its verb."""

PING = "ping"
"""The request that every component answers at once."""

_MAX_PENDING = 32
"""Requests that wait until the component answers them; of each urgent verb again as many."""

_LONGEST_ERROR = 4000
"""Characters of an error in a reply: it may repeat what the request contains."""

_RING = 256
"""Requests that wait in Zenoh's ring until they are read."""


class ControlError(CairnError):
    """A component rejected a request, or did not reply."""


class NoReplyError(ControlError):
    """A component did not reply, or ended before it did."""


class ControlRequest(BaseModel):
    """The payload of a request to a component."""

    model_config = ConfigDict(extra="forbid")
    arguments: dict[str, Any] = Field(default_factory=dict)


def _of_user() -> str:
    """Name the user in whose name commands connect, if the environment gives one."""
    user = os.environ.get("CAIRN_USER")
    return f" (user {user})" if user else ""


class ControlReply(BaseModel):
    """A component's reply: a value, or an error message."""

    model_config = ConfigDict(extra="forbid")
    error: str | None = None
    value: Any = None


def request(
    session: zenoh.Session,
    domain: int,
    component: str,
    verb: str,
    arguments: Mapping[str, Any] | None = None,
    *,
    timeout_s: float,
) -> Any:
    """Send a request to the component of that full name (`/robot/localizer`); return its reply.

    Raises `ControlError` with the component's error if it rejects the request; `NoReplyError`,
    with component, request and timeout, if no reply arrives.
    """
    if not _VERB.fullmatch(verb):
        raise ControlError(f"{component}: {verb!r} is not the name of a request")
    payload = ControlRequest(arguments=dict(arguments or {})).model_dump_json().encode()
    if len(payload) > REQUEST_BYTES:
        raise ControlError(
            f"{component}: the request {verb} has {len(payload):,} bytes, more than the "
            f"{REQUEST_BYTES:,} that are allowed; send less"
        )
    start = time.monotonic()
    try:
        replies = session.get(
            control_key(domain, component, verb),
            payload=payload,
            # Otherwise one false queryable that does not answer would hide the component.
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    except zenoh.ZError as error:
        raise ControlError(f"{component}: cannot send the request {verb}: {error}") from error
    invalid: ControlError | None = None
    for received in replies:
        if received.ok is not None:
            try:
                reply = _parsed_reply(component, received.ok.payload)
            except ControlError as error:  # perhaps of a false queryable
                invalid = error
                continue
            if reply.error is not None:
                raise ControlError(reply.error)
            return reply.value
    if invalid is not None:
        raise invalid
    waited_s = time.monotonic() - start
    if waited_s < timeout_s:
        raise NoReplyError(
            f"{component}: no reply to {verb}, and none will arrive, after {waited_s:.1f} s: "
            "the component is not running, has just ended, the link to it was lost, or, over the "
            "network or from another machine of the robot, your role does not allow the request"
            f"{_of_user()}; `cairn ps` lists the running components, docs/how-to/connect.md what a "
            "role allows"
        )
    raise NoReplyError(
        f"{component}: no reply to {verb} within {timeout_s:g} s: it hangs or is still busy; "
        "`cairn ps` shows in which handler"
    )


def answering(session: zenoh.Session, domain: int, robot: str, timeout_s: float) -> Iterator[str]:
    """Yield the full name of each component of a robot (`*`: of any) that answers, when it does.

    A liveliness token proves nothing, as any peer can declare one; an answer does.
    """
    prefix = control_key(domain, "", "").rstrip("/")
    replies = session.get(
        control_key(domain, f"/{robot}/*", PING),
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=timeout_s,
    )
    for received in replies:
        if received.ok is not None:
            with suppress(ControlError):
                _parsed_reply(robot, received.ok.payload)
                yield str(received.ok.key_expr).removeprefix(prefix).rpartition("/")[0]


class ControlServer:
    """Receives the requests to one component and replies to them on the component's loop."""

    def __init__(
        self,
        session: zenoh.Session,
        domain: int,
        component: str,
        post: Callable[[Callable[[], None]], None],
        answer: Callable[[str, Mapping[str, Any]], Any],
        max_bytes: Mapping[str, int] = MappingProxyType({}),
        urgent: Collection[str] = (),
    ) -> None:
        """Open the queryable of the component of that full name.

        Args:
            session: the session of the component's process.
            domain: the deployment's domain.
            component: full name, `/robot/localizer`.
            post: makes a call on the component's loop.
            answer: `answer(verb, arguments)` returns the reply's value; it is called through
                `post`, and a `CairnError` from it rejects the request.
            max_bytes: longest request [bytes] of the verbs whose limit is not 64 KiB.
            urgent: verbs that are received and accepted however many requests of others wait.
        """
        self._max_bytes = max_bytes
        self._urgent = frozenset(urgent)
        self._lock = threading.Lock()
        self._replies = ReplyThread("cairn replies")
        self._pending: Counter[str] = Counter()  # by urgent verb; "" counts all others
        self._key = control_key(domain, component)
        self._post = post
        self._answer = answer
        # Each urgent verb has a ring of its own, which a flood of other requests does not fill.
        self._readers: list[ChannelReader] = []
        for verb in ("", *sorted(self._urgent)):
            queryable: Any = session.declare_queryable(
                control_key(domain, component, verb) if verb else self._key,
                zenoh.handlers.RingChannel(_RING),
            )
            self._readers.append(
                ChannelReader(queryable, partial(self._serve, verb), "cairn control")
            )

    def close(self) -> None:
        """Stop receiving requests."""
        for reader in self._readers:
            reader.close()
        self._replies.close()

    def _serve(self, urgent: str, query: zenoh.Query) -> None:
        """Receive a request if it has this urgent verb; "": any other one."""
        if self._kind(_verb(query)) == urgent:
            self._receive(query)

    def _kind(self, verb: str) -> str:
        return verb if verb in self._urgent else ""

    def _receive(self, query: zenoh.Query) -> None:
        verb = _verb(query)
        if not _VERB.fullmatch(verb):
            self._reply(query, ControlReply(error=f"{verb[:100]!r} is not the name of a request"))
            return
        if verb == PING:  # not by the component's loop, which may be busy
            _send(query, self._reply_key(PING), ControlReply().model_dump_json().encode())
            return
        try:
            received = _parsed_request(query, self._max_bytes.get(verb, _DEFAULT_BYTES))
        except ValueError as error:
            self._reply(query, ControlReply(error=f"invalid control request {verb}: {error}"))
            return
        kind = self._kind(verb)
        with self._lock:
            busy = self._pending[kind] >= _MAX_PENDING
            if not busy:
                self._pending[kind] += 1
        if busy:
            waiting = f"busy: {_MAX_PENDING} requests wait already; send {verb} again later"
            self._reply(query, ControlReply(error=waiting))
            return
        self._post(partial(self._handle, query, verb, kind, received.arguments))

    def _handle(
        self, query: zenoh.Query, verb: str, kind: str, arguments: Mapping[str, Any]
    ) -> None:
        with self._lock:
            self._pending[kind] -= 1
        try:
            reply = ControlReply(value=self._answer(verb, arguments))
        except CairnError as error:
            text = str(error)
            if len(text) > _LONGEST_ERROR:
                text = f"{text[:_LONGEST_ERROR]}... ({len(text):,} characters)"
            reply = ControlReply(error=text)
        self._reply(query, reply)

    def _reply(self, query: zenoh.Query, reply: ControlReply) -> None:
        try:
            payload = reply.model_dump_json().encode()
        except ValueError as error:  # a value that JSON cannot carry: the component's defect
            payload = _error(f"the reply is not JSON: {error}")
        if len(payload) > REPLY_BYTES:
            payload = _error(
                f"the reply has {len(payload):,} bytes, more than the {REPLY_BYTES:,} that are "
                "allowed; request less at a time"
            )
        key = self._reply_key(_verb(query))
        if not self._replies.send(partial(_send, query, key, payload), len(payload)):
            payload = _error("too many replies wait to be sent; request less at a time")
            self._replies.send(partial(_send, query, key, payload), 0)

    def _reply_key(self, verb: str) -> str:
        """Return this component's own key, also if the request was to several components."""
        return self._key.removesuffix("*") + verb


def _send(query: zenoh.Query, key: str, payload: bytes) -> None:
    with query, suppress(zenoh.ZError):  # the requester may have ended
        query.reply(key, payload)


def _verb(query: zenoh.Query) -> str:
    return str(query.key_expr).rpartition("/")[2]


def _error(text: str) -> bytes:
    return ControlReply(error=text).model_dump_json().encode()


def _parsed_request(query: zenoh.Query, longest: int) -> ControlRequest:
    """Return the request of a query; raise `ValueError` if it is invalid or too long."""
    return ControlRequest.model_validate(_parsed(query.payload or zenoh.ZBytes(b""), longest))


def _parsed_reply(component: str, payload: zenoh.ZBytes) -> ControlReply:
    try:
        return ControlReply.model_validate(_parsed(payload, REPLY_BYTES))
    except ValueError as error:
        raise ControlError(f"{component}: invalid reply to a control request: {error}") from error


def _parsed(payload: zenoh.ZBytes, longest: int) -> Any:
    if len(payload) > longest:  # before it is copied
        raise too_large(len(payload), longest)
    return parse_json(payload.to_bytes(), longest)
