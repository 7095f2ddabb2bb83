"""Every type that a file defines: hash, bytes, other implementations, damaged bytes."""

import json
import math
import re
import struct
import tracemalloc
import zlib
from collections import Counter, defaultdict
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from cairn.bus.codec import Codec, to_plain
from cairn.bus.message_limits import length_of
from cairn.bus.type_hash import definition, type_description, type_hash
from cairn.schemas.definitions import PLACEHOLDER, DefinitionError
from cairn.schemas.interfaces import (
    find_message,
    interface,
    interface_names,
    interface_type_names,
    packages,
)
from cairn.schemas.message import InvalidMessage, fields_of
from cairn.schemas.sensor_msgs.msg import JoyFeedback, JoyFeedbackArray
from cairn.schemas.shape_msgs.msg import Mesh, MeshTriangle
from cairn.schemas.std_msgs.msg import Empty
from cairn.schemas.std_srvs.srv import Trigger
from tests.schemas.damage import decode_damaged
from tests.schemas.random_messages import DATA, HASHES, RandomMessages, message_names
from tests.sweeps import sampled
from tests.wording import words_in_order

MESSAGES = 4  # of each type
CODEC = Codec()

pytestmark = pytest.mark.slow


def _by_package() -> dict[str, list[str]]:
    found = defaultdict(list)
    for name in message_names():
        found[name.split("/")[0]].append(name)
    return dict(found)


BY_PACKAGE = _by_package()
every_package = pytest.mark.parametrize("package", sampled(BY_PACKAGE, 4))


@cache
def messages(name: str) -> tuple[Any, ...]:
    """Return random messages of a type; every other one has ASCII texts alone."""
    random = RandomMessages(zlib.crc32(name.encode()))
    return tuple(random.make(interface(name), ascii=n % 2 == 0) for n in range(MESSAGES))


def test_every_type_has_the_hash_of_the_official_generator() -> None:
    assert {name: type_hash(interface(name)) for name in HASHES} == HASHES


def test_official_generator_knows_every_type_of_ros_2() -> None:
    named = {name for name in interface_type_names() if not name.startswith("cairn_")}
    assert named <= set(HASHES)
    assert len(HASHES) == 727


def test_description_of_an_action_equals_the_official_one() -> None:
    official = json.loads((DATA / "NavigateToPose.json").read_text())
    ours = type_description(interface("nav2_msgs/action/NavigateToPose"))

    assert _without_defaults(ours) == _without_defaults(official)


def _without_defaults(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_defaults(one) for key, one in value.items() if key != "default_value"}
    return [_without_defaults(one) for one in value] if isinstance(value, list) else value


@every_package
def test_message_is_the_same_after_it_was_sent(package: str) -> None:
    for name in BY_PACKAGE[package]:
        cls = interface(name)
        for message in messages(name):
            encoded = CODEC.encode(message)
            decoded = CODEC.decode(cls, encoded)

            assert decoded == message, name
            assert hash(decoded) == hash(message)
            assert CODEC.encode(decoded) == encoded
            assert _unpadded(message) == length_of(message) - 4, name


def _unpadded(value: Any, element: str = "") -> int:
    """Return the length of a value as CDR without header and padding, by another way."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, str):
        return 5 + len(value.encode())
    if hasattr(value, "__ros_type__"):
        total = 0
        for field in fields_of(type(value)):
            one = getattr(value, field.name)
            total += 4 if field.count == 0 else 0
            total += _unpadded(getattr(one, "array", one), str(field.element))
        return total
    if isinstance(value, bool | int | float):
        return np.dtype("uint8" if element == "byte" else element).itemsize
    return sum(_unpadded(one) for one in value)


@cache
def rosbags_store() -> Typestore:
    """Return the types as rosbags reads them in the files; with those that ROS 2 adds."""
    store = Typestore()
    for package, folder in packages().items():
        for kind, parts in _PARTS.items():
            for name in interface_names(folder, kind):
                text = (folder / kind / f"{name}.{kind}").read_text(encoding="utf-8")
                texts = re.split("^---[ \t]*$", text, flags=re.MULTILINE)
                full = f"{package}/{kind}/{name}"
                for part, one in zip(parts, texts, strict=True):
                    ((_, described),) = get_types_from_msg(one, f"{package}/msg/{name}").items()
                    store.fielddefs[full + part] = described if described[1] else _NOTHING
                if kind == "srv":
                    _add_event(store, full)
                elif kind == "action":
                    _add_implementation(store, full)
    store.types.update({name: _RosbagsMessage.of(store, name) for name in store.fielddefs})
    return store


_PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}
_UINT8 = (Nodetype.BASE, ("uint8", 0))
_NOTHING: Any = ([], [(PLACEHOLDER, _UINT8)])


def _add_event(store: Typestore, service: str) -> None:
    described: Any = [
        (side.lower(), (Nodetype.SEQUENCE, ((Nodetype.NAME, f"{service}_{side}"), 1)))
        for side in ("Request", "Response")
    ]
    described.insert(0, ("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")))
    store.fielddefs[f"{service}_Event"] = ([], described)


def _add_implementation(store: Typestore, action: str) -> None:
    def add(part: str, **members: Any) -> None:
        described: Any = [
            (
                name,
                (Nodetype.NAME if "/" in one else Nodetype.BASE, one if "/" in one else (one, 0)),
            )
            for name, one in members.items()
        ]
        store.fielddefs[f"{action}_{part}"] = ([], described)

    goal_id = "unique_identifier_msgs/msg/UUID"
    add("SendGoal_Request", goal_id=goal_id, goal=f"{action}_Goal")
    add("SendGoal_Response", accepted="bool", stamp="builtin_interfaces/msg/Time")
    add("GetResult_Request", goal_id=goal_id)
    add("GetResult_Response", status="int8", result=f"{action}_Result")
    add("FeedbackMessage", goal_id=goal_id, feedback=f"{action}_Feedback")
    for service in ("SendGoal", "GetResult"):
        _add_event(store, f"{action}_{service}")


class _RosbagsMessage:
    """What rosbags decodes a message to."""

    __msgtype__ = ""
    __names__: tuple[str, ...] = ()

    def __init__(self, /, *values: Any) -> None:
        self.__dict__.update(zip(type(self).__names__, values, strict=True))

    @classmethod
    def of(cls, store: Typestore, name: str) -> type[Any]:
        """Return the class of messages of a type."""
        names = tuple(field for field, _ in store.fielddefs[name][1])
        return type("Made", (cls,), {"__msgtype__": name, "__names__": names})


@every_package
def test_rosbags_decodes_and_encodes_the_same(package: str) -> None:
    store = rosbags_store()
    for name in BY_PACKAGE[package]:
        for message in messages(name):
            encoded = CODEC.encode(message)
            theirs = store.deserialize_cdr(encoded, name)

            assert _values(theirs) == _values(message), name
            assert bytes(store.serialize_cdr(theirs, name)) == encoded, name
            big_endian = bytes(store.serialize_cdr(theirs, name, little_endian=False))
            assert CODEC.decode(type(message), big_endian) == message, name


def _values(value: Any) -> Any:
    """Return a message of either implementation as dictionaries and lists.

    rosbags has a byte as a signed number; in ROS 2 it is an unsigned one.
    """
    if isinstance(value, _RosbagsMessage):
        kinds = dict(rosbags_store().fielddefs[value.__msgtype__][1])
        return {
            field: _unsigned(kinds[field], _values(vars(value)[field]))
            for field in type(value).__names__
        }
    if hasattr(value, "__ros_type__"):
        return {field.name: _values(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return [_values(one) for one in value.tolist()]
    if isinstance(value, float) and math.isnan(value):
        return "NaN"
    if isinstance(value, bool | int | float | str):
        return value
    return [_values(one) for one in value]


def _unsigned(kind: Any, value: Any) -> Any:
    if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return [_unsigned(kind[1][0], one) for one in value]
    return value % 256 if kind == (Nodetype.BASE, ("byte", 0)) else value


@every_package
def test_other_tools_parse_the_definition_of_a_message(package: str) -> None:
    for name in BY_PACKAGE[package]:
        text = definition(interface(name))
        store = Typestore()
        types = get_types_from_msg(text, name)
        store.register({one: fields if fields[1] else _NOTHING for one, fields in types.items()})
        main = next(iter(types))

        for message in messages(name)[:2]:
            encoded = CODEC.encode(message)
            theirs = store.deserialize_cdr(encoded, main)
            assert bytes(store.serialize_cdr(theirs, main)) == encoded, name


@every_package
def test_damaged_message_of_any_type_is_valid_or_rejected(
    package: str, interface_mutations: int
) -> None:
    outcomes: Counter[str] = Counter()
    for name in BY_PACKAGE[package]:
        originals = [CODEC.encode(message) for message in messages(name)]
        decoded = decode_damaged(CODEC, interface(name), originals, interface_mutations)
        outcomes += decoded.outcomes
    assert min(outcomes["valid"], outcomes["rejected"]) > 0


@every_package
def test_memory_of_any_type_is_bounded_by_the_size_of_the_bytes(package: str) -> None:
    for name in BY_PACKAGE[package]:
        cls = interface(name)
        original = max(map(CODEC.encode, messages(name)), key=len)[:600]
        data = original + bytes(400)
        _decode_or_reject(cls, data)
        tracemalloc.start()
        for start in range(4, len(original) - 3, 16):
            for count in (len(data) - start, 2**32 - 1):
                _decode_or_reject(cls, data[:start] + struct.pack("<I", count) + data[start + 4 :])
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 200_000 + 500 * len(data), name


def _decode_or_reject(cls: type[Any], data: bytes) -> None:
    try:
        CODEC.decode(cls, data)
    except InvalidMessage:
        return


@pytest.mark.accuracy
def test_memory_of_a_long_sequence_of_small_messages_is_bounded() -> None:
    sequences = {
        field.element: (name, field)
        for name in message_names()
        for field in fields_of(interface(name))
        if isinstance(field.element, type) and field.count == 0 and not field.packed
    }
    for element, (name, field) in sequences.items():
        small = element()
        size = len(CODEC.encode(small)) - 4
        if size > 16 or field.most or name.endswith("MultiEchoLaserScan"):
            continue
        data = CODEC.encode(interface(name)(**{field.name: (small,) * (50_000 // size)}))
        tracemalloc.start()
        _decode_or_reject(interface(name), data)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 50 * len(data), f"{name}: {peak / len(data)} for each byte"


def test_long_sequences_of_messages_in_use_are_decoded() -> None:
    mesh = Mesh(triangles=(MeshTriangle(),) * 50_000)
    assert CODEC.decode(Mesh, CODEC.encode(mesh)) == mesh

    array = JoyFeedbackArray(array=(JoyFeedback(),) * 50_000)
    with pytest.raises(InvalidMessage, match=words_in_order("JoyFeedbackArray", "small messages")):
        CODEC.decode(JoyFeedbackArray, CODEC.encode(array))


@every_package
def test_messages_are_compared_by_their_fields(package: str) -> None:
    for name in BY_PACKAGE[package]:
        cls = interface(name)
        one, *others = messages(name)
        assert one == RandomMessages(zlib.crc32(name.encode())).make(cls, ascii=True)
        assert one != object()
        differing = [other for other in others if CODEC.encode(other) != CODEC.encode(one)]
        for other in differing:
            assert (other != one) or _has_negative_zero(one, other), name


def _has_negative_zero(*values: Any) -> bool:
    # 0.0 equals -0.0, and their bytes differ.
    return any("-0.0" in repr(value) or "-0." in repr(value) for value in values)


def test_field_of_a_message_without_fields_is_not_shown() -> None:
    assert to_plain(Empty()) == {}
    assert to_plain({PLACEHOLDER: 0}) == {}
    assert to_plain(Trigger.Event(request=(Trigger.Request(),)))["request"] == [{}]
    assert CODEC.encode(Empty()) == bytes((0, 1, 0, 0, 0))
    assert definition(Empty) == "# no fields\n"


def test_messages_are_found_by_their_full_names_alone() -> None:
    assert find_message("std_msgs/msg/Empty") is Empty
    assert find_message("std_srvs/srv/Trigger_Request") is Trigger.Request
    assert find_message("cairn_msgs/msg/PortStatus") is not None
    for name in (
        "std_msgs/Empty",
        "std_srvs/srv/Trigger",
        "nav2_msgs/action/Spin",
        "std_msgs/msg/Nothing",
        "no_msgs/msg/Nothing",
        "field_types/msg/Scalar",
        "../../etc/passwd",
        "std_msgs/msg/" + "X" * 300,
        "",
    ):
        assert find_message(name) is None, name


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("std_msgs/msg/Nothing", ("std_msgs/msg/Nothing", "Nothing.msg is missing")),
        ("std_srvs/srv/Trigger_Goal", ("Trigger_Goal", "does not define it")),
        ("no_msgs/msg/X", ("no_msgs/msg/X", "no package no_msgs", "cairn schema import")),
        ("Nothing", ("'Nothing'", "not the name of a ROS 2 interface")),
        ("std_msgs/msg/" + "X" * 10_000, ("std_msgs/msg/XX", "is not the name")),
    ],
)
def test_unknown_type_is_an_error_with_its_name(name: str, words: tuple[str, ...]) -> None:
    with pytest.raises(DefinitionError, match=words_in_order(*words)):
        interface(name)


def test_unknown_name_in_a_module_is_an_attribute_error() -> None:
    from cairn.schemas.std_srvs import srv

    assert "Trigger" in dir(srv)
    with pytest.raises(AttributeError, match="has no attribute 'Triger'"):
        srv.Triger  # type: ignore[attr-defined] # noqa: B018 - the access is the test
