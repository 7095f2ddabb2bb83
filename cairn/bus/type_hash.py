"""ROS 2 type hashes (REP 2016) and `.msg` definitions of message classes, computed by rosbags."""

from typing import TYPE_CHECKING, Any, cast

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.typesys.store import Typestore

from cairn.schemas.message import Field, constants_of, fields_of, type_name

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Constdefs


_hashes: dict[type[Any], str] = {}


def type_hash(message: type[Any]) -> str:
    """Return the ROS 2 type hash of a message class: "RIHS01_" and 64 hex digits.

    It is part of every data key, so that only nodes with the same definition communicate.
    """
    known = _hashes.get(message)
    if known is None:
        known = _hashes[message] = _typestore(message).hash_rihs01(type_name(message))
    return known


def definition(message: type[Any]) -> str:
    """Return the text of the .msg file and of those it refers to, as rosbag2 stores them."""
    return _typestore(message).generate_msgdef(type_name(message), ros_version=2)[0]


def field_type(field: Field) -> FieldDesc:
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


def _typestore(message: type[Any]) -> Typestore:
    """Return the definitions of a message class and of the classes of its fields."""
    store = Typestore()
    _define(store, message)
    return store


def _define(store: Typestore, message: type[Any]) -> None:
    name = type_name(message)
    if name in store.fielddefs:
        return
    for field in fields_of(message):
        if isinstance(field.element, type):
            _define(store, field.element)
    constants = [(one.name, one.ros_type, one.value) for one in constants_of(message)]
    described = [(field.name, field_type(field)) for field in fields_of(message)]
    store.fielddefs[name] = (cast("Constdefs", constants), described)
