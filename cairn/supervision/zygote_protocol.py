"""What a zygote and its clients say to each other: one JSON object a line, over a Unix socket."""

import json
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from cairn.errors import CairnError

_LONGEST_LINE = 16 << 20  # bytes; a deployment's largest argument is some kilobytes


class ProtocolError(CairnError):
    """The other side sent what is not of the zygote's protocol."""


@dataclass(frozen=True)
class Spawn:
    """Client: start a process of this name that calls `entry` with `argument`.

    It is refused if one of the modules in `needs` could not be preloaded.
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
    """Client: send a signal to one of its processes, or to that process's whole group."""

    request: int
    pid: int
    signal: int
    group: bool
    kind: Literal["signal"] = "signal"


@dataclass(frozen=True)
class Hello:
    """Zygote, first of all: its pid, and per module why it failed or which threads it started."""

    pid: int
    failures: dict[str, str]
    threads: dict[str, list[str]]
    kind: Literal["hello"] = "hello"


@dataclass(frozen=True)
class Spawned:
    """Zygote: the process asked for runs."""

    request: int
    pid: int
    kind: Literal["spawned"] = "spawned"


@dataclass(frozen=True)
class Done:
    """Zygote: the signal was sent, or the process has ended before."""

    request: int
    kind: Literal["done"] = "done"


@dataclass(frozen=True)
class Refused:
    """Zygote: the request was not carried out."""

    request: int
    error: str
    kind: Literal["refused"] = "refused"


@dataclass(frozen=True)
class Ended:
    """Zygote: a process of the client ended, with an exit code or by a signal."""

    pid: int
    name: str
    code: int | None
    signal: int | None
    kind: Literal["ended"] = "ended"


Request = Spawn | Signal
Answer = Hello | Spawned | Done | Refused | Ended

_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="kind")])
_ANSWER: TypeAdapter[Answer] = TypeAdapter(Annotated[Answer, Field(discriminator="kind")])


def request_line(request: Request) -> bytes:
    """A request as it goes over the socket. Raises `TypeError` if its argument is not JSON."""
    return json.dumps(asdict(request)).encode() + b"\n"  # keeps NaN, unlike pydantic


def answer_line(answer: Answer) -> bytes:
    """An answer as it goes over the socket."""
    return _ANSWER.dump_json(answer) + b"\n"


def read_request(line: bytes) -> Request:
    """The request in a line. Raises `ProtocolError`."""
    try:
        return _REQUEST.validate_json(line)
    except ValidationError as error:
        raise ProtocolError(f"a client of the zygote sent no valid request: {error}") from error


def read_answer(line: bytes) -> Answer:
    """The answer in a line. Raises `ProtocolError`."""
    try:
        return _ANSWER.validate_json(line)
    except ValidationError as error:
        raise ProtocolError(f"the zygote sent no valid answer: {error}") from error


class Lines:
    """Cuts a stream of bytes into lines."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The lines complete with these bytes. Raises `ProtocolError` if one is too long."""
        self._rest += data
        *lines, rest = self._rest.split(b"\n")
        if len(rest) > _LONGEST_LINE:
            raise ProtocolError(f"a line of the zygote's protocol exceeds {_LONGEST_LINE} bytes")
        self._rest = rest
        return [bytes(line) for line in lines]
