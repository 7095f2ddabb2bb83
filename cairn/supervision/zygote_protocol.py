"""The messages between the zygote and its clients: one JSON object per line on a Unix socket."""

import json
import signal
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from cairn.errors import CairnError

_LONGEST_LINE = 16 << 20  # bytes; a deployment's largest argument is some kilobytes


class ProtocolError(CairnError):
    """The other side sent something that is not of the zygote's protocol."""


@dataclass(frozen=True)
class Spawn:
    """Client: start a process of this name that calls `entry` with `argument`.

    The zygote refuses if one of the modules in `needs` could not be preloaded.
    """

    request: int
    name: str
    entry: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    argument: dict[str, Any]
    log_file: str
    fresh: bool
    needs: tuple[str, ...]
    kind: Literal["spawn"] = "spawn"


@dataclass(frozen=True)
class Signal:
    """Client: send a signal to one of its processes, or kill that process's whole group."""

    request: int
    pid: int
    signal: int
    group: bool
    kind: Literal["signal"] = "signal"


@dataclass(frozen=True)
class Hello:
    """Zygote, first message: it has finished its imports."""

    kind: Literal["hello"] = "hello"


@dataclass(frozen=True)
class Spawned:
    """Zygote: the requested process runs."""

    request: int
    pid: int
    kind: Literal["spawned"] = "spawned"


@dataclass(frozen=True)
class Done:
    """Zygote: the signal was sent, or the process had ended before."""

    request: int
    kind: Literal["done"] = "done"


@dataclass(frozen=True)
class RequestRefused:
    """Zygote: the request was not carried out."""

    request: int
    error: str
    kind: Literal["refused"] = "refused"


@dataclass(frozen=True)
class Exited:
    """Zygote: a process of the client ended, with an exit code or by a signal; the other is None.

    Its whole process group has ended: its devices and ports are free.
    """

    pid: int
    name: str
    code: int | None
    signal: int | None
    kind: Literal["exited"] = "exited"

    @property
    def manner(self) -> str:
        """How the process ended, such as "exit code 1" or "killed by SIGSEGV (signal 11)"."""
        if self.signal is None:
            return f"exit code {self.code}"
        try:
            name = signal.Signals(self.signal).name
        except ValueError:
            name = "a real-time signal"
        return f"killed by {name} (signal {self.signal})"

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid}): {self.manner}"


Request = Spawn | Signal
Answer = Hello | Spawned | Done | RequestRefused | Exited

_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="kind")])
_ANSWER: TypeAdapter[Answer] = TypeAdapter(Annotated[Answer, Field(discriminator="kind")])


def encode_request(request: Request) -> bytes:
    """Encode a request as a line. Raises `TypeError` if its argument cannot be JSON."""
    return json.dumps(asdict(request)).encode() + b"\n"  # keeps NaN, unlike pydantic


def encode_answer(answer: Answer) -> bytes:
    """Encode an answer as a line."""
    return _ANSWER.dump_json(answer) + b"\n"


def decode_request(line: bytes) -> Request:
    """Decode the request in a line. Raises `ProtocolError`."""
    try:
        return _REQUEST.validate_json(line)
    except ValidationError as error:
        raise ProtocolError(f"it sent an invalid request: {error}") from error


def decode_answer(line: bytes) -> Answer:
    """Decode the answer in a line. Raises `ProtocolError`."""
    try:
        return _ANSWER.validate_json(line)
    except ValidationError as error:
        raise ProtocolError(f"the zygote sent an invalid answer: {error}") from error


class LineSplitter:
    """Splits a stream of bytes into lines."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines completed by these bytes; `ProtocolError` if one is too long."""
        self._rest += data
        *lines, rest = self._rest.split(b"\n")
        if len(rest) > _LONGEST_LINE:
            raise ProtocolError(f"a line of the zygote's protocol exceeds {_LONGEST_LINE} bytes")
        self._rest = rest
        return [bytes(line) for line in lines]
