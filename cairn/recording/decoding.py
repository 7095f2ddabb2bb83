"""Decodes recorded messages: to Cairn's classes, else by the definitions in the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, cast

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError
from rosbags.typesys.msg import get_types_from_msg
from rosbags.typesys.store import Typestore

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition, type_hash
from cairn.errors import RecordingError
from cairn.recording.mcap_file import RecordedChannel, RecordedMessage
from cairn.schemas.definitions import PLACEHOLDER
from cairn.schemas.interfaces import find_message
from cairn.schemas.message import InvalidMessage

_SCHEMA_BYTES: Final = 256_000
_MOST_TYPES: Final = 500
_MOST_FIELDS: Final = 5_000
_LONGEST_ARRAY: Final = 1_000  # of strings or messages, for which code is generated one by one
_FEW_MESSAGES: Final = 10_000
# A message without fields has one byte on the wire.
_NOTHING: Final[list[tuple[str, FieldDesc]]] = [(PLACEHOLDER, (Nodetype.BASE, ("uint8", 0)))]
_FAILURES: Final = (
    TypesysError, SerdeError, InvalidMessage, ValueError, KeyError, IndexError, AssertionError,
    RecursionError, MemoryError, SyntaxError,
)  # fmt: skip


@dataclass(frozen=True)
class Definition:
    """The definition of the message type `name` and of the types in it, as rosbags describes it."""

    name: str
    types: Typesdict

    def fields(self, name: str) -> list[tuple[str, FieldDesc]]:
        """Return names and types of the fields of a type; `RecordingError` if it is missing."""
        if name not in self.types:
            raise RecordingError(f"the definition of {self.name} lacks {name[:100]}")
        return list(self.types[name][1]) or _NOTHING


class MessageDecoder:
    """Decodes recorded messages; not thread-safe.

    A type that Cairn knows with the same definition becomes Cairn's class, any other one a
    dictionary by the definition in the recording.
    """

    def __init__(self) -> None:
        self._codec = Codec()
        self._decoders: dict[RecordedChannel, Callable[[bytes], Any]] = {}

    def decode(self, message: RecordedMessage) -> Any:
        """Return an object of a message class, or a dictionary with arrays for numbers.

        Raises `RecordingError` if the message is damaged, or its definition is missing.
        """
        channel = message.channel
        decode = self._decoders.get(channel)
        try:
            if decode is None:
                decode = self._decoders[channel] = self._decoder(channel)
            return decode(message.data)
        except _FAILURES as error:
            raise RecordingError(
                f"{channel.topic}: message {message.sequence} of type {channel.type[:100]} cannot "
                f"be decoded: {_text(error)}; leave the topic out"
            ) from error

    def definition(self, channel: RecordedChannel) -> Definition:
        """Return the definition of a channel's messages, as `decode` decodes them.

        Raises `RecordingError` if there is none.
        """
        known = self.message_class(channel)
        try:
            if known is not None:
                return _defined(channel.type, definition(known).encode())
            _check_encoding(channel)
            return _defined(channel.type, channel.schema)
        except _FAILURES as error:
            raise RecordingError(
                f"{channel.topic}: its type {channel.type[:100]} is not known: {_text(error)}; "
                "leave the topic out"
            ) from error

    def message_class(self, channel: RecordedChannel) -> type[Any] | None:
        """Return the class to which a channel's messages are decoded; None for a dictionary."""
        known = find_message(channel.type)
        if known is None or channel.encoding != "cdr":
            return None
        recorded = channel.type_hash
        if recorded and recorded != type_hash(known):
            return None
        # Without a hash, as in rosbag2's files before Iron, the name has to do.
        return known

    def _decoder(self, channel: RecordedChannel) -> Callable[[bytes], Any]:
        known = self.message_class(channel)
        if known is not None:
            return lambda data: self._codec.decode(known, data)
        _check_encoding(channel)
        return _by_definition(_defined(channel.type, channel.schema))


def _text(error: Exception) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__


def _check_encoding(channel: RecordedChannel) -> None:
    if channel.encoding != "cdr":
        raise ValueError(f"its encoding {channel.encoding[:20]!r} is not cdr")
    if channel.schema_encoding != "ros2msg" or not channel.schema:
        raise ValueError("the recording does not hold its definition (ros2msg)")


def _defined(name: str, schema: bytes) -> Definition:
    """Return the types that a text of the encoding `ros2msg` defines.

    rosbags generates code from a definition. Its grammar admits nothing but names there; the number
    of statements is limited here.
    """
    if len(schema) > _SCHEMA_BYTES:
        raise ValueError(f"its definition has {len(schema):,} bytes, above {_SCHEMA_BYTES:,}")
    # A line without a field costs its parser as much as a field, of which the number is limited.
    lines = (line.strip() for line in schema.decode().split("\n"))
    text = "".join(f"{line}\n" for line in lines if line and not line.startswith("#"))
    types = get_types_from_msg(text, name)
    fields = [field for _, (_, of) in types.items() for field in of]
    if len(types) > _MOST_TYPES or len(fields) > _MOST_FIELDS:
        raise ValueError(f"its definition has {len(types)} types with {len(fields)} fields")
    for field, kind in fields:
        if kind[0] == Nodetype.ARRAY:
            element, length = cast("tuple[FieldDesc, int]", kind[1])
            is_number = element[0] == Nodetype.BASE and element[1][0] != "string"
            if length > (2**32 if is_number else _LONGEST_ARRAY):
                raise ValueError(f"its field {field} has {length:,} elements")
    types = {
        one: (constants, [(field, _with_unsigned_bytes(kind)) for field, kind in of])
        for one, (constants, of) in types.items()
    }
    # rosbags names the messages of services in its own way: its first one is that of the channel.
    return Definition(name if name in types else next(iter(types)), types)


def _with_unsigned_bytes(kind: Any) -> Any:
    """Return the type of a field; a byte is signed in rosbags, and in ROS 2 unsigned."""
    if kind[0] == Nodetype.BASE:
        return (Nodetype.BASE, ("uint8", 0)) if kind[1][0] == "byte" else kind
    if kind[0] == Nodetype.NAME:
        return kind
    element, count = kind[1]
    return (kind[0], (_with_unsigned_bytes(element), count))


def _by_definition(definition: Definition) -> Callable[[bytes], Any]:
    """Return a function that decodes messages into dictionaries."""
    budget = _Budget()
    store = Typestore()
    for name, (constants, _) in definition.types.items():
        fields = definition.fields(name)
        store.fielddefs[name] = (constants, fields)
        store.types[name] = cast("type", budget.maker([field for field, _ in fields]))

    def decode(data: bytes) -> Any:
        budget.left = _FEW_MESSAGES + len(data)
        return store.deserialize_cdr(memoryview(data), definition.name)

    return decode


class _Budget:
    """How many messages one message may still contain: each byte may be one, in many levels."""

    left = 0

    def maker(self, names: list[str]) -> Callable[..., dict[str, Any]]:
        """Return a function that makes a dictionary of values, and counts it."""

        def make(*values: Any) -> dict[str, Any]:
            self.left -= 1
            if self.left < 0:
                raise SerdeError("it contains more messages than it has bytes")
            return dict(zip(names, values, strict=True))

        return make
