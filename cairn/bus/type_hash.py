"""ROS 2 type hashes (RIHS01), type descriptions (REP 2016) and `.msg` definitions of classes."""

import hashlib
import json
from typing import Any, Final

from cairn.schemas.definitions import PLACEHOLDER
from cairn.schemas.message import Field, classes_in, constants_of, fields_of, type_name

_TYPE_IDS: Final = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8,
    "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
"""Those of `type_description_interfaces/msg/FieldType`."""

_SEPARATOR: Final = "=" * 80

_NESTED, _BOUNDED_STRING = 1, 21
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144

_hashes: dict[type[Any], str] = {}


def type_hash(interface: type[Any]) -> str:
    """Return the ROS 2 type hash of a message, service or action: "RIHS01_" and 64 hex digits.

    It is part of every data key, so that only nodes with the same definition communicate.
    """
    known = _hashes.get(interface)
    if known is None:
        text = json.dumps(_description(interface))
        known = _hashes[interface] = f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"
    return known


def type_description(interface: type[Any]) -> dict[str, Any]:
    """Return the content of the JSON file in which `rosidl` describes a type, with all hashes.

    Its form is that of `type_description_interfaces/msg/TypeDescription` (REP 2016).
    """
    described = _description(interface)
    for one in (described["type_description"], *described["referenced_type_descriptions"]):
        for field in one["fields"]:
            field["default_value"] = ""
    referenced = sorted(set(classes_in(interface)) - {interface}, key=type_name)
    return {
        "type_description_msg": described,
        "type_hashes": [
            {"type_name": type_name(one), "hash_string": type_hash(one)}
            for one in (interface, *referenced)
        ],
    }


def _description(interface: type[Any]) -> dict[str, Any]:
    """Return a type and those of its fields, as they are hashed."""
    referenced = sorted(set(classes_in(interface)) - {interface}, key=type_name)
    return {
        "type_description": _individual(interface),
        "referenced_type_descriptions": [_individual(one) for one in referenced],
    }


def _individual(interface: type[Any]) -> dict[str, Any]:
    return {
        "type_name": type_name(interface),
        "fields": [
            {"name": field.name, "type": _field_description(field)}
            for field in fields_of(interface)
        ],
    }


def _field_description(field: Field) -> dict[str, Any]:
    nested = field.element if isinstance(field.element, type) else None
    if nested is not None:
        type_id = _NESTED
    elif field.text_most is not None:
        type_id = _BOUNDED_STRING
    else:
        type_id = _TYPE_IDS[str(field.element)]
    if field.count:
        type_id += _ARRAY
    elif field.most is not None:
        type_id += _BOUNDED_SEQUENCE
    elif field.count is not None:
        type_id += _SEQUENCE
    return {
        "type_id": type_id,
        "capacity": field.count or field.most or 0,
        "string_capacity": field.text_most or 0,
        "nested_type_name": "" if nested is None else type_name(nested),
    }


def definition(message: type[Any]) -> str:
    """Return the text of the .msg file and of those it refers to, as rosbag2 stores them.

    A message of a service or action has its full name there: `nav2_msgs/action/Spin_Goal`.
    """
    text, *others = (own_definition(one) for one in classes_in(message))
    _, *names = (type_name(one).replace("/msg/", "/") for one in classes_in(message))
    return text + "".join(
        f"{_SEPARATOR}\nMSG: {name}\n{other}" for name, other in zip(names, others, strict=True)
    )


def own_definition(message: type[Any]) -> str:
    """Return the text of a .msg file with the constants and fields of one message class.

    It is never empty: in a recording, an empty text stands for a definition that is not known.
    """
    lines = [f"{one.ros_type} {one.name}={one.value}" for one in constants_of(message)]
    for field in fields_of(message):
        if field.name == PLACEHOLDER:
            continue
        bounded = "" if field.text_most is None else f"<={field.text_most}"
        element = field.element
        one = type_name(element) if isinstance(element, type) else f"{element}{bounded}"
        most = "" if field.most is None else f"<={field.most}"
        many = "" if field.count is None else f"[{field.count or most}]"
        lines.append(f"{one.replace('/msg/', '/')}{many} {field.name}")
    return "".join(f"{line}\n" for line in lines or ["# no fields"])
