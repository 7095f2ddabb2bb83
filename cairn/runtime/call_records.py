"""The records of a call log: what was called, what it read, what it published; their encoding.

The records of one start of a component are one stream, cut into batches (`CallLog`). Numbers are
differences from the last one of their kind, as varints; names and publishers are numbered when they
first occur. So a typical record takes 2 to 5 bytes, and a batch can be decoded only after all of
those before it.
"""

from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict

from cairn.errors import CairnError
from cairn.runtime.input_files import InputFile

T = TypeVar("T")

GID_BYTES: Final = 16
_LONGEST_TEXT: Final = 1 << 24
_MAX_TABLE: Final = 100_000


class RecordKind(IntEnum):
    """What a record says; its values are named in the order in which they follow.

    A record that begins a call is followed by what happened during the call.
    """

    START = 0  # JSON: which start this is; then the component is constructed
    TRANSITION = 1  # of the life cycle: name
    MESSAGE = 2  # a message for the handlers of a port: port, gid, sequence
    CLOCK = 3  # a message on topic `clock`: time [ns]
    TIMERS = 4  # timers are due
    POSTED = 5  # what the component has posted in a call
    FOREIGN = 6  # what another thread has posted
    REQUEST = 7  # verb, arguments as JSON
    HOST = 8  # a call of what hosts the component: name
    CALLED = 9  # a call of a server: port, client's gid, sequence, request
    ANSWERED = 10  # the answer to a call of a client: port, sequence, response
    FAILED = 11  # a call of a client has failed: port, sequence, reason
    # During a call:
    PENDING = 16  # a message that is handled within another call: port, gid, sequence
    TIME = 17  # a reading of the clock: time [ns]
    HAS_SUBSCRIBERS = 18  # of an output: port
    NO_SUBSCRIBERS = 19  # of an output: port
    SENT = 20  # a publication: port, sequence number
    NOT_SENT = 21  # a publication that nothing subscribes to: port
    OPENED = 22  # an output: port, gid
    OUTCOME = 23  # JSON: what a supervisor's children have answered
    ENDED = 24  # JSON: how the component ended
    CUT = 25  # the log of this start ends here: reason
    REPLIED = 26  # a server has answered: port, client's gid, sequence, response
    REFUSED = 27  # a server has refused a call: port, client's gid, sequence, reason
    REQUESTED = 28  # a client has called: port, sequence, request
    PENDING_CALL = 29  # a call of a server, within another call: as CALLED

    @property
    def begins_call(self) -> bool:
        """Whether a call begins with it."""
        return self < RecordKind.PENDING


Record = tuple[Any, ...]
"""A kind and its values."""


class StartInfo(BaseModel):
    """With what a component was started: the value of the record `START`.

    Attributes:
        paths: parameters that are paths, by dotted name.
        read_paths: names of those that the component only reads.
        files: the input files as they were.
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    name: str
    plugin: str
    parameters: dict[str, Any]
    topics: dict[str, str]
    max_age_s: dict[str, float] = {}
    children: tuple[str, ...] = ()
    incarnation: int
    robot: str
    seed: int
    simulated_time: bool
    lockstep: bool
    paths: dict[str, str] = {}
    read_paths: tuple[str, ...] = ()
    files: tuple[InputFile, ...] = ()


_VALUES: Final[dict[int, str]] = {
    RecordKind.START: "j",
    RecordKind.TRANSITION: "n",
    RecordKind.MESSAGE: "ngs",
    RecordKind.CLOCK: "t",
    RecordKind.TIMERS: "",
    RecordKind.POSTED: "",
    RecordKind.FOREIGN: "",
    RecordKind.REQUEST: "nj",
    RecordKind.HOST: "n",
    RecordKind.CALLED: "ngsb",
    RecordKind.ANSWERED: "nsb",
    RecordKind.FAILED: "nsj",
    RecordKind.PENDING: "ngs",
    RecordKind.TIME: "t",
    RecordKind.HAS_SUBSCRIBERS: "n",
    RecordKind.NO_SUBSCRIBERS: "n",
    RecordKind.SENT: "ns",
    RecordKind.NOT_SENT: "n",
    RecordKind.OPENED: "ng",
    RecordKind.OUTCOME: "j",
    RecordKind.ENDED: "j",
    RecordKind.CUT: "j",
    RecordKind.REPLIED: "ngsb",
    RecordKind.REFUSED: "ngsj",
    RecordKind.REQUESTED: "nsb",
    RecordKind.PENDING_CALL: "ngsb",
}
"""The values of each kind: a JSON or other text, bytes, a name, a gid, a time, or a number.

The number is a sequence number of the publisher or client, or of the port, that precedes it.
"""


class CallLogError(CairnError):
    """A call log is damaged."""


class RecordEncoder:
    """Encodes the records of one start, in order."""

    def __init__(self) -> None:
        self._tables: dict[str, dict[Any, int]] = {"n": {}, "g": {}}
        self._time = 0
        self._last: dict[Any, int] = {}  # sequence numbers, by publisher or port

    def encode(self, record: Record, data: bytearray) -> None:
        """Append one record to `data`."""
        kind = record[0]
        data.append(kind)
        whose: Any = None
        for code, value in zip(_VALUES[kind], record[1:], strict=True):
            if code == "t":
                _append_signed(data, value - self._time)
                self._time = value
            elif code == "s":
                _append_signed(data, value - self._last.get(whose, 0))
                self._last[whose] = value
            elif code in ("j", "b"):
                content = value.encode() if code == "j" else value
                _append(data, len(content))
                data += content
            else:
                whose = value
                table = self._tables[code]
                index = table.get(value)
                if index is not None:
                    _append(data, index)
                    continue
                _append(data, len(table))
                table[value] = len(table)
                if code == "n":
                    text = value.encode()
                    _append(data, len(text))
                    data += text
                else:
                    data += value


class RecordDecoder:
    """Decodes the records of one start, batch after batch; checks everything."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._gids: list[bytes] = []
        self._time = 0
        self._last: dict[Any, int] = {}
        self._data = b""
        self._at = 0

    def decode(self, data: bytes) -> Iterator[Record]:
        """Yield the records of the next batch; raises `CallLogError` if it is damaged."""
        self._data, self._at = data, 0
        while self._at < len(data):
            yield self._record()

    def _record(self) -> Record:
        number = self._data[self._at]
        codes = _VALUES.get(number)
        if codes is None:
            raise CallLogError(f"byte {self._at}: there are no records of kind {number}")
        self._at += 1
        values: list[Any] = [RecordKind(number)]
        whose: Any = None
        for code in codes:
            if code == "t":
                self._time += self._signed()
                values.append(self._time)
            elif code == "s":
                value = self._last[whose] = self._last.get(whose, 0) + self._signed()
                values.append(value)
            elif code == "j":
                values.append(self._text())
            elif code == "b":
                values.append(self._content())
            else:
                whose = self._name() if code == "n" else self._gid()
                values.append(whose)
        return tuple(values)

    def _name(self) -> str:
        return self._entry(self._names, self._text)

    def _gid(self) -> bytes:
        return self._entry(self._gids, lambda: self._bytes(GID_BYTES))

    def _entry(self, table: list[T], new: Callable[[], T]) -> T:
        index = self._number()
        if index == len(table) < _MAX_TABLE:
            table.append(new())
        elif index >= len(table):
            raise CallLogError(f"byte {self._at}: entry {index} of a table of {len(table)}")
        return table[index]

    def _content(self) -> bytes:
        length = self._number()
        if length > _LONGEST_TEXT:
            raise CallLogError(f"byte {self._at}: a text of {length:,} bytes")
        return self._bytes(length)

    def _text(self) -> str:
        try:
            return self._content().decode()
        except UnicodeDecodeError as error:
            raise CallLogError(f"byte {self._at}: a text is not UTF-8") from error

    def _bytes(self, count: int) -> bytes:
        part = self._data[self._at : self._at + count]
        if len(part) < count:
            raise CallLogError("it ends within a record")
        self._at += count
        return part

    def _signed(self) -> int:
        number = self._number()
        return -(number >> 1) - 1 if number & 1 else number >> 1

    def _number(self) -> int:
        number = shift = 0
        while True:
            if self._at >= len(self._data):
                raise CallLogError("it ends within a record")
            byte = self._data[self._at]
            self._at += 1
            number |= (byte & 0x7F) << shift
            if byte < 0x80:
                return number
            shift += 7
            if shift > 63:
                raise CallLogError(f"byte {self._at}: a number of more than 64 bits")


def _append_signed(data: bytearray, value: int) -> None:
    _append(data, value << 1 if value >= 0 else (-value << 1) - 1)


def _append(data: bytearray, number: int) -> None:
    while number >= 0x80:
        data.append(number & 0x7F | 0x80)
        number >>= 7
    data.append(number)
