"""Control requests to components (life cycle, parameters, loading), beside the data plane.

A request is JSON on a queryable of the component. Zenoh ends a query that nobody answers with
silence, whether the component is missing, dies, or hangs; here each of these is an error.
"""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import zenoh
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cairn.bus.keys import control_key
from cairn.errors import CairnError


class ControlError(CairnError):
    """A request was refused, or there was no answer."""


class NoReplyError(ControlError):
    """Nobody answered, or whoever was to answer has gone."""


class ControlRequest(BaseModel):
    """What is asked of a component."""

    model_config = ConfigDict(extra="forbid")
    verb: str = Field(max_length=100)
    arguments: dict[str, Any] = Field(default_factory=dict)


class ControlReply(BaseModel):
    """What it answers: a value, or why not."""

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
    """Ask the component with that full name (`/robot/localizer`) and return its answer.

    Raises `ControlError` with the component's error if it rejects the request; `NoReplyError`,
    with component, request and limit, if no reply arrives.
    """
    asked = ControlRequest(verb=verb, arguments=dict(arguments or {}))
    begun = time.monotonic()
    try:
        replies = session.get(
            control_key(domain, component),
            payload=asked.model_dump_json(),
            timeout=timeout_s,
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    except zenoh.ZError as error:
        raise ControlError(f"{component} cannot be asked: {error}") from error
    for reply in replies:
        if reply.ok is not None:
            answer = _reply(component, reply.ok.payload.to_bytes())
            if answer.error is not None:
                raise ControlError(answer.error)
            return answer.value
    waited_s = time.monotonic() - begun
    if waited_s < timeout_s:
        raise NoReplyError(
            f"{component} gave no answer to {verb}, and after {waited_s:.1f} s it was certain that "
            "none would come: it is not running, has just ended, or the link to it was lost; "
            "`cairn ps` shows what runs"
        )
    raise NoReplyError(
        f"{component} gave no answer to {verb} within {timeout_s:g} s: it hangs, or is "
        "still busy; `cairn ps` shows with what"
    )


class ControlServer:
    """Receives the requests to one component and has them answered on its thread."""

    def __init__(
        self,
        session: zenoh.Session,
        domain: int,
        component: str,
        post: Callable[[Callable[[], None]], None],
        answer: Callable[[str, Mapping[str, Any]], Any],
    ) -> None:
        """`answer(verb, arguments)` is called through `post`; a `CairnError` refuses."""
        self._key = control_key(domain, component)
        self._post = post
        self._answer = answer
        self._queryable: zenoh.Queryable[Any] = session.declare_queryable(
            self._key, zenoh.handlers.RingChannel(64)
        )
        self._thread = threading.Thread(target=self._serve, name="cairn control", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer no more."""
        self._queryable.undeclare()
        self._thread.join(timeout=2.0)

    def _serve(self) -> None:
        channel = self._queryable.handler
        while True:
            try:
                query = channel.recv()
            except zenoh.ZError:  # the queryable was undeclared
                return
            self._receive(query)
            del query  # whoever asks learns of the component's end when nobody holds this any more

    def _receive(self, query: zenoh.Query) -> None:
        payload = query.payload.to_bytes() if query.payload is not None else b""
        try:
            asked = ControlRequest.model_validate_json(payload)
        except ValidationError as error:
            self._reply(query, ControlReply(error=f"not a control request: {error}"))
            return
        self._post(partial(self._handle, query, asked))

    def _handle(self, query: zenoh.Query, asked: ControlRequest) -> None:
        try:
            reply = ControlReply(value=self._answer(asked.verb, asked.arguments))
        except CairnError as error:
            reply = ControlReply(error=str(error))
        self._reply(query, reply)

    def _reply(self, query: zenoh.Query, reply: ControlReply) -> None:
        try:
            answer = reply.model_dump_json()
        except ValueError as error:  # a value that JSON cannot carry: the component's defect
            answer = ControlReply(error=f"its answer cannot be sent: {error}").model_dump_json()
        with query, suppress(zenoh.ZError):  # who asked may be gone
            query.reply(self._key, answer)


def _reply(component: str, payload: bytes) -> ControlReply:
    try:
        return ControlReply.model_validate_json(payload)
    except ValidationError as error:
        raise ControlError(f"{component} gave an answer that is none: {error}") from error
