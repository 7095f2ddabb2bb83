"""Codec: encode and decode messages as CDR.

rosbags generates the code for CDR; here are what decodes into Cairn's message classes, and packed
sequences, which are encoded and decoded in one piece.

A decoded message takes memory in proportion to its bytes: counts are checked against the bytes that
follow, and sequences of messages that are much larger in memory than on the wire have a budget.
"""

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any, Final, TypeVar, cast

import numpy as np
from rosbags.interfaces import CDRDeser, CDRSer, CDRSerSize, Nodetype
from rosbags.interfaces import Typestore as TypestoreProtocol
from rosbags.interfaces.typing import FieldDesc
from rosbags.serde import SerdeError
from rosbags.serde.cdr import generate_deserialize_cdr, generate_getsize_cdr, generate_serialize_cdr
from rosbags.serde.primitives import pack_uint32_le, unpack_uint32_be, unpack_uint32_le
from rosbags.typesys.base import normalize_fieldname

from cairn.errors import CairnError
from cairn.schemas.definitions import PLACEHOLDER
from cairn.schemas.message import (
    Field,
    InvalidMessage,
    decoding_constructor,
    fields_of,
    independent_elements,
    received_message,
    repairs_of,
    set_repairs,
    type_name,
)
from cairn.schemas.packed import Packed

M = TypeVar("M")


_HEADER: Final = 4  # bytes of the encapsulation
_MOST_PADDING: Final = 3  # bytes behind a message
_NUMBER = 8  # bytes, and alignment, of a float64

_MEMORY_PER_BYTE = 48
"""A message that needs more memory than this for each of its bytes is dense. Of those of ROS 2 that
come in thousands, poses need 23, and triangles of meshes, the most, 46 (measured)."""

_DENSE_MEMORY = 4 * 1024 * 1024
"""The dense messages in the sequences of one message may take this memory [bytes]: a scan of 1081
beams with several echoes takes 1.2 MB."""


class Codec:
    """CDR as ROS 2 writes it, for every class decorated with `@message`; thread-safe.

    A class is registered when it is first used, with the classes of its fields.
    """

    def __init__(self) -> None:
        self._classes: dict[str, type[Any]] = {}
        # Decodes into message classes, packed sequences in one piece.
        self._wire = _Store()
        self._definitions: dict[type[Any], _Definition] = {}
        # Decodes into tuples without validation, to find out which field of a message is invalid.
        self._plain = _Store()
        self._budget = _MemoryBudget()
        # The types that have dense messages in a sequence, at any depth.
        self._budgeted: set[str] = set()

    def encode(self, message: Any) -> bytes:
        """Return a message as little-endian CDR with the 4-byte encapsulation header.

        Raises `TypeError` if `message` is not of a message class.
        """
        cls = type(message)
        code = self._definitions.get(cls) or self._definition(cls)
        store: Any = self._wire
        data = bytearray(_HEADER + code.getsize_cdr(0, message, store))
        data[1] = 1  # little-endian
        code.serialize_cdr_le(memoryview(data)[_HEADER:], 0, message, store)
        return bytes(data)

    def decode(self, cls: type[M], data: bytes | memoryview) -> M:
        """Return the message in CDR `data` of either byte order.

        Its arrays are views of `data`, without a copy, and keep it alive; float64 arrays may be
        unaligned, which numpy handles but C code may not. An invalid message is repaired
        if its class defines how (`repairs_of`). Raises `InvalidMessage`, and no other error, if
        `data` does not become a valid message of class `cls`.
        """
        code = self._definitions.get(cls) or self._definition(cls)
        view = memoryview(data if type(data) is bytes or _is_plain(data) else bytes(data))
        if self._budgeted and code.name in self._budgeted:
            self._budget.left = _DENSE_MEMORY
        try:
            message: M = self._wire.decode(code, view)
        except (SerdeError, InvalidMessage) as error:
            failure = str(error)
        else:
            return message
        return self._repaired(cls, view, failure)

    def register(self, cls: type[Any]) -> None:
        """Prepare for messages of a class, if that is not done yet.

        Raises `TypeError` if it is not a message class, `CairnError` if another class has the name.
        """
        self._definition(cls)

    def prepare(self, cls: type[Any]) -> None:
        """Register a class, and generate the code that its first message would need."""
        code = self._definition(cls)
        for field in fields_of(cls):
            if isinstance(field.element, type):
                self.prepare(field.element)
        _ = code.getsize_cdr, code.serialize_cdr_le, code.deserialize_cdr_le

    def _definition(self, cls: type[Any]) -> "_Definition":
        name = type_name(cls)
        known = self._classes.get(name)
        if known is None:
            self._add(name, cls)
        elif known is not cls:
            raise CairnError(
                f"{name} is defined twice: by {_qualified_name(known)} and by "
                f"{_qualified_name(cls)}; "
                "import the same class in both places"
            )
        return self._wire.definitions[name]

    def _add(self, name: str, cls: type[Any]) -> None:
        wire: list[tuple[str, FieldDesc]] = []
        plain: list[tuple[str, FieldDesc]] = []
        for field in fields_of(cls):
            element = field.element
            if isinstance(element, type):
                self.register(element)
            # A byte is unsigned in ROS 2, signed in rosbags.
            as_sent = replace(field, element="uint8") if element == "byte" else field
            plain.append((normalize_fieldname(field.name), _field_type(as_sent)))
            wire.append(plain[-1])
            if field.packed and isinstance(element, type):
                whole = f"Packed[{type_name(element)}]"
                self._wire.definitions[whole] = _packed(whole, element, self._wire)
                wire[-1] = (wire[-1][0], (Nodetype.NAME, whole))
            elif isinstance(element, type):
                if field.count == 0 and _memory(element) > _MEMORY_PER_BYTE * _least_size(element):
                    plain[-1] = wire[-1] = (wire[-1][0], self._dense_sequence(element))
                    self._budgeted.add(name)
                if type_name(element) in self._budgeted:
                    self._budgeted.add(name)
        self._plain.add(name, plain, _as_tuple)
        self._wire.add(name, wire, decoding_constructor(cls))
        self._definitions[cls] = self._wire.definitions[name]
        self._classes[name] = cls  # last, so that a thread that finds it there finds all

    def _dense_sequence(self, element: type[Any]) -> FieldDesc:
        """Return the description of a sequence whose elements are charged to the budget."""
        name = type_name(element)
        charged = f"Charged[{name}]"
        for store in (self._wire, self._plain):
            known = store.definitions[name]
            store.add(charged, known.fields, self._budget.charging(_memory(element), known.cls))
        return (Nodetype.SEQUENCE, ((Nodetype.NAME, charged), 0))

    def _repaired(self, cls: type[M], data: memoryview, failure: str) -> M:
        """Decode a message a second time, slowly: repair it, or name the field that is invalid."""
        name = type_name(cls)
        self._budget.left = _DENSE_MEMORY
        try:
            values = self._plain.decode(self._plain.definitions[name], data)
            message: M = self._build(cls, values)
        except SerdeError as error:
            failure = str(error)
        else:
            if repairs_of(message):
                return message
        raise InvalidMessage(
            name, "", bytes(data[:16]), f"{len(data)} bytes are not CDR of this type: {failure}"
        )

    def _build(self, cls: type[Any], values: Any) -> Any:
        """Return a message of plain values, built and repaired from the inside out.

        Errors and repairs name the whole path.
        """
        built: dict[str, Any] = {}
        repairs: list[str] = []
        for field, value in zip(fields_of(cls), values, strict=True):
            if isinstance(field.element, type):
                built[field.name] = self._build_parts(cls, field, value, repairs)
            else:
                built[field.name] = value
        message = received_message(cls, built)
        set_repairs(message, [*repairs, *repairs_of(message)])
        return message

    def _build_parts(self, cls: type[Any], field: Field, value: Any, repairs: list[str]) -> Any:
        """Return the messages in a field of messages; append what was repaired in them."""
        element = cast("type[Any]", field.element)
        made: list[Any] = []
        first: InvalidMessage | None = None
        for index, item in enumerate([value] if field.count is None else value):
            try:
                part = self._build(element, item)
            except InvalidMessage as error:
                path = field.name if field.count is None else f"{field.name}[{index}]"
                first = first or error.within(type_name(cls), path)
                if field.name not in independent_elements(cls):
                    raise first from None
                continue
            made.append(part)
            repairs += [f"{field.name}.{text}" for text in repairs_of(part)]
        if first is not None:
            if not made:
                raise first
            repairs.append(f"invalid {field.name} left out")
        return made[0] if field.count is None else made


class _Store:
    """The types that a codec knows, as code that rosbags generates finds them."""

    max_sequence_length = 2**32 - 1

    def __init__(self) -> None:
        self.definitions: dict[str, _Definition] = {}
        self.get_msgdef = self.definitions.__getitem__

    def add(self, name: str, fields: list[tuple[str, FieldDesc]], make: Callable[..., Any]) -> None:
        """Add a type, whose messages `make` makes of their fields in order."""
        self.definitions[name] = _Definition(name, fields, make, self)

    def decode(self, code: "_Definition", data: memoryview) -> Any:
        """Return a message in CDR of either byte order; `SerdeError` for other bytes."""
        if len(data) < _HEADER or data[0] != 0 or data[1] > 1:
            raise SerdeError("Invalid or unsupported CDR encapsulation.")
        deserialize = code.deserialize_cdr_le if data[1] else code.deserialize_cdr_be
        store: Any = self
        try:
            message, end = deserialize(data[_HEADER:], 0, code.cls, store)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise SerdeError(str(error)) from error
        if end + _HEADER + _MOST_PADDING < len(data):
            raise SerdeError("CDR message size mismatch.")
        return message


@dataclass(eq=False)
class _Definition:
    """The code for CDR of one type, generated when it is first used.

    Its names are those of `rosbags.interfaces.Msgdef`, which has code for more formats.
    """

    name: str
    fields: list[tuple[str, FieldDesc]]
    cls: Any
    """Makes a message of its fields in order."""
    _store: Any

    @cached_property
    def _size(self) -> tuple[CDRSerSize, int]:
        return generate_getsize_cdr(self.fields, self._store)

    @cached_property
    def size_cdr(self) -> int:
        """Size [bytes] if all messages of the type have the same, otherwise 0."""
        return self._size[1]

    @cached_property
    def getsize_cdr(self) -> CDRSerSize:
        """Function that returns the position behind a message at a position."""
        return self._size[0]

    @cached_property
    def serialize_cdr_le(self) -> CDRSer:
        """Function that writes a message at a position, and returns the one behind it."""
        return generate_serialize_cdr(self.fields, self._store, "le")

    @cached_property
    def deserialize_cdr_le(self) -> CDRDeser:
        """Function that returns the message at a position, and the position behind it."""
        return generate_deserialize_cdr(self.fields, self._store, "le")

    @cached_property
    def deserialize_cdr_be(self) -> CDRDeser:
        """The same for big-endian CDR."""
        return generate_deserialize_cdr(self.fields, self._store, "be")


class _MemoryBudget(threading.local):
    """The memory that the dense messages of the message being decoded may still take [bytes]."""

    left: int = 0

    def charging(self, memory: int, make: Callable[..., Any]) -> Callable[..., Any]:
        """Return a constructor that charges `memory` [bytes] for each call of `make`."""

        def charged(*values: Any) -> Any:
            self.left -= memory
            if self.left < 0:
                raise SerdeError(
                    f"more than {_DENSE_MEMORY // memory} small messages in its sequences"
                )
            return make(*values)

        return charged


def _memory(cls: type[Any]) -> int:
    """Return the memory that the smallest decoded message of a class takes [bytes], rounded up.

    The numbers are those of CPython 3.11 and numpy 2: an object with its dictionary, entries of
    that, and arrays each with a view of the bytes.
    """
    memory = 200
    for field in fields_of(cls):
        memory += 24
        if field.packed:
            memory += 450
        elif isinstance(field.element, type):
            memory += 72 if field.count == 0 else (field.count or 1) * (8 + _memory(field.element))
        elif field.count is not None:
            memory += 72 if field.element == "string" else 320
        elif field.element != "string":
            memory += 32
    return memory


def _least_size(cls: type[Any]) -> int:
    """Return the size of the smallest message of a class on the wire [bytes], without padding."""
    size = 0
    for field in fields_of(cls):
        if field.count == 0:
            size += 4
            continue
        if isinstance(field.element, type):
            least = _least_size(field.element)
        else:
            least = 5 if field.element == "string" else np.dtype(field.element).itemsize
        size += least * (field.count or 1)
    return size


def to_plain(message: Any, longest: int | None = None) -> Any:
    """Return a message as dictionaries, lists and scalars, for people and for JSON.

    It is of a message class, or a dictionary of fields, as of a type that Cairn does not know. The
    field that a message without fields has on the wire is left out.
    Sequences longer than `longest` are cut, with a note of how many elements were left out.
    """
    if is_dataclass(message):
        return {
            field.name: to_plain(getattr(message, field.name), longest)
            for field in fields(message)
            if field.name != PLACEHOLDER
        }
    if isinstance(message, dict):
        return {
            name: to_plain(value, longest) for name, value in message.items() if name != PLACEHOLDER
        }
    if isinstance(message, np.ndarray):
        shown = message if longest is None else message[:longest]
        return _cut(shown.tolist(), len(message))
    if isinstance(message, str | bytes | int | float | bool):
        return message
    if isinstance(message, np.generic):
        return message.item()
    items = list(message)
    shown_items = items if longest is None else items[:longest]
    return _cut([to_plain(item, longest) for item in shown_items], len(items))


def _is_plain(data: bytes | memoryview) -> bool:
    # A buffer that may change later, or is not simply bytes, is copied.
    if isinstance(data, bytes):
        return True
    return data.readonly and data.format == "B" and data.ndim == 1 and data.c_contiguous


def _field_type(field: Field) -> FieldDesc:
    """Return the type of a field as rosbags describes it."""
    if isinstance(field.element, type):
        one: Any = (Nodetype.NAME, type_name(field.element))
    else:
        one = (Nodetype.BASE, (field.element, field.text_most or 0))
    if field.count is None:
        return cast("FieldDesc", one)
    if field.count:
        return cast("FieldDesc", (Nodetype.ARRAY, (one, field.count)))
    return cast("FieldDesc", (Nodetype.SEQUENCE, (one, field.most or 0)))


def _as_tuple(*values: Any) -> tuple[Any, ...]:
    return values


def _qualified_name(cls: type[Any]) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


def _cut(shown: list[Any], length: int) -> list[Any]:
    left = length - len(shown)
    return [*shown, f"... {left} more"] if left else shown


def _packed(name: str, element: type[Any], store: _Store) -> _Definition:
    """Return the definition of a packed sequence of `element`."""
    # So that the code generated around it aligns it as a sequence of float64.
    numbers: FieldDesc = (Nodetype.SEQUENCE, ((Nodetype.BASE, ("float64", 0)), 0))
    columns = Packed(element).array.shape[1]
    packed = _Definition(name, [("numbers", numbers)], Packed, store)
    packed.size_cdr = 0
    packed.getsize_cdr = _size
    packed.serialize_cdr_le = _serialize
    packed.deserialize_cdr_le = _deserializer(element, columns, unpack_uint32_le, "<f8")
    packed.deserialize_cdr_be = _deserializer(element, columns, unpack_uint32_be, ">f8")
    return packed


def _size(position: int, packed: Any, _: TypestoreProtocol) -> int:
    size: int = packed.array.nbytes
    return _start(position, len(packed)) + size


def _start(position: int, count: int) -> int:
    # After the count; there is padding only if numbers follow.
    position += 4
    return (position + _NUMBER - 1) & -_NUMBER if count else position


def _serialize(raw: memoryview, position: int, packed: Any, _: TypestoreProtocol) -> int:
    array = packed.array
    pack_uint32_le(raw, position, len(array))
    start = _start(position, len(array))
    end: int = start + array.nbytes
    raw[start:end] = array.astype("<f8", copy=False).reshape(-1).view(np.uint8)
    return end


def _deserializer(
    element: type[Any],
    columns: int,
    unpack: Callable[[bytes | memoryview, int], tuple[int]],
    dtype: str,
) -> CDRDeser:
    def deserialize(
        raw: bytes | memoryview, position: int, _cls: type, _: TypestoreProtocol
    ) -> tuple[object, int]:
        (count,) = unpack(raw, position)
        start = _start(position, count)
        end = start + count * columns * _NUMBER
        if end > len(raw):
            raise SerdeError(f"Invalid sequence length {count} at offset {position}.")
        numbers = np.frombuffer(raw, dtype, count * columns, start if count else 0)
        return Packed(element, numbers.reshape(count, columns)), end

    return deserialize
