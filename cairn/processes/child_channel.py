"""The private channel between a supervisor and the process of one child.

A pair of connected sockets: the supervisor keeps one end, and the child's process gets the other
one when it is spawned (`launcher.py`). No other process can write to it, so supervision
believes what it reads here, and nothing that is published on the bus. The supervisor sends requests
for transitions of the life cycle, and announces a stop; the child answers requests, and sends
heartbeats. Each message is one JSON object in one packet.
"""

import json
import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from cairn.errors import CairnError
from cairn.runtime.lifecycle import LifecycleState

Verb = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]

LONGEST_PACKET = 64 << 10  # bytes
_LONGEST_TEXT = 8000  # characters, of which each takes at most 6 bytes in JSON
_SEND_LIMIT_S = 1.0
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class Request:
    """Supervisor: make this transition."""

    number: int
    verb: Verb
    kind: Literal["request"] = "request"


@dataclass(frozen=True, config=_STRICT)
class StopAhead:
    """Supervisor: start nothing any more; all below you must stop within `limit_s` [s]."""

    limit_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    kind: Literal["stop_ahead"] = "stop_ahead"


@dataclass(frozen=True, config=_STRICT)
class TransitionAnswer:
    """Child: the requested transition was made, or with `error` the component's own reason why not.

    A heartbeat with the state after the transition precedes it.
    """

    number: int
    error: Annotated[str, Field(max_length=_LONGEST_TEXT)] = ""
    kind: Literal["answer"] = "answer"


@dataclass(frozen=True, config=_STRICT)
class Heartbeat:
    """Child: its state, and the current handler ("" if none) with its running time [s]."""

    state: LifecycleState
    handler: Annotated[str, Field(max_length=_LONGEST_TEXT)] = ""
    handler_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    kind: Literal["heartbeat"] = "heartbeat"


_TO_CHILD: TypeAdapter[Request | StopAhead] = TypeAdapter(
    Annotated[Request | StopAhead, Field(discriminator="kind")]
)
_FROM_CHILD: TypeAdapter[TransitionAnswer | Heartbeat] = TypeAdapter(
    Annotated[TransitionAnswer | Heartbeat, Field(discriminator="kind")]
)
_M = TypeVar("_M")


class InvalidPacket(CairnError):
    """The other side of a channel has sent something that is not a message."""


def channel_pair() -> tuple[socket.socket, socket.socket]:
    """Return the supervisor's and the child's end of a new channel; `exec` closes both."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


class SupervisorChannel:
    """The supervisor's end; it never waits for the child to read.

    All methods are for one thread, except `announce_stop`.

    `heartbeat` is the newest that was received, None before the first; `heartbeats` counts them.
    """

    def __init__(self, end: socket.socket) -> None:
        self.heartbeat: Heartbeat | None = None
        self.heartbeats = 0
        self.closed = False
        """Whether the child's end is closed: its process has ended, or is about to."""
        self._end = end
        self._lock = threading.Lock()  # while another thread sends, this end stays open
        self._number = 0
        self.answer: TransitionAnswer | None = None  # to the last request

    def announce_stop(self, limit_s: float) -> None:
        """Tell the child that all below it must stop within `limit_s` [s]; from any thread."""
        with self._lock:
            if not self.closed:
                _send(self._end, StopAhead(max(0.0, limit_s)), 0.0)

    def request(self, verb: Verb) -> bool:
        """Send a request; its answer will be `answer`. Return whether it could be sent.

        It cannot if the child is gone, or has not read its requests for long.
        """
        self._number += 1
        self.answer = None
        return not self.closed and _send(self._end, Request(self._number, verb), 0.0)

    def receive(self, timeout_s: float) -> None:
        """Take all messages that have arrived; wait at most `timeout_s` [s] for the first one.

        Raises `InvalidPacket`.
        """
        if self.closed or not _ready(self._end, select.POLLIN, timeout_s):
            return
        while not self.closed and (packet := self._packet()) is not None:
            message = _parsed(_FROM_CHILD, packet)
            if isinstance(message, Heartbeat):
                self.heartbeat = message
                self.heartbeats += 1
            elif message.number == self._number:  # otherwise the request has timed out before
                self.answer = message

    def close(self) -> None:
        """Close this end."""
        with self._lock:
            self.closed = True
            self._end.close()

    def _packet(self) -> bytes | None:
        """Return the next packet, None if there is none now."""
        try:
            packet = self._end.recv(LONGEST_PACKET + 1, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except OSError:  # the child has ended without having read everything
            packet = b""
        if not packet:
            self.closed = True
            return None
        return packet


class ChildChannel:
    """The child's end: one thread receives requests; any thread sends."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._lock = threading.Lock()

    def receive(self) -> Request | StopAhead | None:
        """Wait for a message and return it; None when one side has closed the channel.

        Raises `InvalidPacket`.
        """
        try:
            packet = self._end.recv(LONGEST_PACKET + 1)
        except OSError:
            return None
        return _parsed(_TO_CHILD, packet) if packet else None

    def send_heartbeat(self, current: Callable[[], Heartbeat]) -> None:
        """Send the current heartbeat; it is dropped if the supervisor does not read now."""
        with self._lock:  # the last one that is sent has the last state
            _send(self._end, current(), 0.0)

    def send_answer(self, answer: TransitionAnswer) -> None:
        """Send an answer; it is dropped if the supervisor has not read for long."""
        _send(self._end, answer, _SEND_LIMIT_S)

    def stop_receiving(self) -> None:
        """Have `receive` return None from now on; messages can still be sent."""
        with suppress(OSError):  # the supervisor has ended
            self._end.shutdown(socket.SHUT_RD)


def sendable(text: str) -> str:
    """Return the text as a message can carry it: cut if it is too long, without surrogates."""
    valid = text.encode(errors="replace").decode()
    return valid if len(valid) <= _LONGEST_TEXT else f"{valid[: _LONGEST_TEXT - 3]}..."


def _send(
    end: socket.socket, message: Request | StopAhead | TransitionAnswer | Heartbeat, limit_s: float
) -> bool:
    """Send a message; wait at most `limit_s` [s] while the other side does not read."""
    packet = json.dumps(asdict(message)).encode()
    try:
        if _ready(end, select.POLLOUT, limit_s):
            end.send(packet, socket.MSG_DONTWAIT)
            return True
    except OSError:  # the other side has ended, or other threads have used up the room
        pass
    return False


def _ready(end: socket.socket, event: int, timeout_s: float) -> bool:
    poll = select.poll()
    poll.register(end, event)
    return bool(poll.poll(max(0.0, timeout_s) * 1000))


def _parsed(form: TypeAdapter[_M], packet: bytes) -> _M:
    if len(packet) > LONGEST_PACKET:
        raise InvalidPacket(f"a message exceeds {LONGEST_PACKET} bytes")
    try:
        return form.validate_json(packet)
    except ValueError as error:
        raise InvalidPacket(f"a message is invalid: {sendable(str(error))}") from error
