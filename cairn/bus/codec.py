"""Turns messages into CDR bytes and back, and tells their ROS 2 definitions and type hashes."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, cast

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from cairn.bus.packed_cdr import packed_msgdef
from cairn.errors import CairnError
from cairn.schemas.decoding import maker
from cairn.schemas.fields import Field, constants_of, fields_of
from cairn.schemas.message import InvalidMessage, type_name

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Constdefs

M = TypeVar("M")


class Codec:
    """CDR as ROS 2 writes it, for every class decorated with `@message`; thread-safe.

    A class is made known when it is first used, with all that it holds.
    """

    def __init__(self) -> None:
        self._classes: dict[str, type[Any]] = {}
        # As in the .msg files; for hashes and definitions.
        self._described = Typestore()
        # What decodes into our classes, packed sequences in one piece.
        self._wire = Typestore()
        # What decodes into tuples, without any check of ours: tells where an invalid one is so.
        self._plain = Typestore()

    def encode(self, message: Any) -> bytes:
        """CDR, little-endian, with the 4-byte encapsulation header.

        Raises `TypeError` if `message` is not of a message class.
        """
        name = self._known(type(message))
        return bytes(self._wire.serialize_cdr(message, name, little_endian=True))

    def decode(self, cls: type[M], data: bytes | memoryview) -> M:
        """The message in `data`, which may be of either byte order.

        Its arrays are views of `data`, without a copy, and keep it alive; float64 ones are not
        aligned, as numpy can handle but C code may not. Raises `InvalidMessage`, and nothing
        else, if `data` is not a valid message of class `cls`.
        """
        name = self._known(cls)
        view = memoryview(data if _is_plain(data) else bytes(data))
        try:
            return self._wire.deserialize_cdr(view, name)  # type: ignore[return-value]
        except (SerdeError, InvalidMessage) as error:
            failure = str(error)
        raise self._explained(cls, view, failure)

    def type_hash(self, cls: type[Any]) -> str:
        """The type hash of ROS 2 (REP 2016): "RIHS01_" and 64 hex digits."""
        return self._described.hash_rihs01(self._known(cls))

    def definition(self, cls: type[Any]) -> str:
        """The text of the .msg file, followed by those of the messages it holds, as in rosbag2."""
        return self._described.generate_msgdef(self._known(cls), ros_version=2)[0]

    def is_bulk(self, cls: type[Any]) -> bool:
        """Whether messages of this class may be big: they hold an image, a map or the like."""
        return any(
            field.packed
            or (field.count == 0 and field.element in ("int8", "uint8", "byte"))
            or (isinstance(field.element, type) and self.is_bulk(field.element))
            for field in fields_of(cls)
        )

    def _known(self, cls: type[Any]) -> str:
        name = type_name(cls)
        known = self._classes.get(name)
        if known is None:
            self._register(name, cls)
        elif known is not cls:
            raise CairnError(
                f"{name} is defined twice: by {_place(known)} and by {_place(cls)}; "
                "use the same class everywhere"
            )
        return name

    def _register(self, name: str, cls: type[Any]) -> None:
        described: list[tuple[str, FieldDesc]] = []
        wire: list[tuple[str, FieldDesc]] = []
        plain: list[tuple[str, FieldDesc]] = []
        for field in fields_of(cls):
            element = field.element
            if isinstance(element, type):
                self._known(element)
            described.append((field.name, _description(field)))
            # A byte is unsigned in ROS 2, signed in rosbags.
            as_sent = replace(field, element="uint8") if element == "byte" else field
            plain.append((field.name, _description(as_sent)))
            wire.append(plain[-1])
            if field.packed and isinstance(element, type):
                whole = f"Packed[{type_name(element)}]"
                self._wire.cache[whole] = packed_msgdef(whole, element)
                wire[-1] = (field.name, (Nodetype.NAME, whole))
        constants = [(one.name, one.ros_type, one.value) for one in constants_of(cls)]
        self._described.fielddefs[name] = (cast("Constdefs", constants), described)
        self._plain.fielddefs[name] = ([], plain)
        self._plain.types[name] = cast("type", _as_tuple)
        self._wire.fielddefs[name] = ([], wire)
        self._wire.types[name] = cast("type", maker(cls))
        self._classes[name] = cls  # last: who finds it there finds all

    def _explained(self, cls: type[Any], data: memoryview, failure: str) -> InvalidMessage:
        # Only what has failed already comes here: it is decoded once more, slowly.
        name = type_name(cls)
        try:
            _build(cls, self._plain.deserialize_cdr(data, name))
        except InvalidMessage as invalid:
            return invalid
        except SerdeError as error:
            failure = str(error)
        return InvalidMessage(
            name, "", bytes(data[:16]), f"{len(data)} bytes are not its CDR: {failure}"
        )


def _description(field: Field) -> FieldDesc:
    if isinstance(field.element, type):
        one: Any = (Nodetype.NAME, type_name(field.element))
    else:
        one = (Nodetype.BASE, (field.element, 0))
    if field.count is None:
        return cast("FieldDesc", one)
    kind = Nodetype.ARRAY if field.count else Nodetype.SEQUENCE
    return cast("FieldDesc", (kind, (one, field.count)))


def _is_plain(data: bytes | memoryview) -> bool:
    # What may change later, or is not simply bytes, is copied.
    return isinstance(data, bytes) or (
        data.readonly and data.format == "B" and data.ndim == 1 and data.c_contiguous
    )


def _as_tuple(*values: Any) -> tuple[Any, ...]:
    return values


def _build(cls: type[Any], values: Any) -> Any:
    """A message of plain values, from the inside out; `InvalidMessage` tells the whole path."""
    built: list[Any] = []
    for field, value in zip(fields_of(cls), values, strict=True):
        if not isinstance(field.element, type):
            built.append(value)
            continue
        items = [value] if field.count is None else value
        made: list[Any] = []
        for index, item in enumerate(items):
            try:
                made.append(_build(field.element, item))
            except InvalidMessage as error:
                place = field.name if field.count is None else f"{field.name}[{index}]"
                raise error.within(type_name(cls), place) from None
        built.append(made[0] if field.count is None else made)
    return cls(*built)


def _place(cls: type[Any]) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"
