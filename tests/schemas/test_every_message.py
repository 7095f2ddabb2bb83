"""Properties of every message: round trip, the bytes of other implementations, damaged bytes."""

import gc
import resource
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import serialize_dynamic
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition
from cairn.schemas.message import InvalidMessage
from cairn.schemas.packed import Packed
from tests.schemas.arbitrary import EVERY_MESSAGE, OF_ROS_2, arbitrary, samples
from tests.schemas.damage import damaged
from tests.sweeps import sampled

pytestmark = pytest.mark.slow


CODEC = Codec()
ROS = get_typestore(Stores.ROS2_JAZZY)

every_message = pytest.mark.parametrize("name", sampled(EVERY_MESSAGE, 12))


@every_message
@settings(max_examples=20)
@given(st.data())
def test_bytes_are_decoded_and_equal_those_of_independent_encoders(
    name: str, data: st.DataObject
) -> None:
    message = data.draw(valid_messages(name))
    encoded = CODEC.encode(message)

    decoded = CODEC.decode(type(message), encoded)
    assert decoded == message
    assert hash(decoded) == hash(message)
    assert CODEC.encode(decoded) == encoded
    assert independent_encoder(name)(plain(message)) == encoded
    if name in OF_ROS_2:
        theirs = ROS.deserialize_cdr(encoded, name)
        assert bytes(ROS.serialize_cdr(theirs, name)) == encoded
        big_endian = bytes(ROS.serialize_cdr(theirs, name, little_endian=False))
        assert CODEC.decode(type(message), big_endian) == message


@cache
def valid_messages(name: str) -> st.SearchStrategy[Any]:
    """Return the strategy for messages of a type."""
    return arbitrary(EVERY_MESSAGE[name])


@cache
def independent_encoder(name: str) -> Callable[[Any], bytes]:
    """Return the encoder of another implementation, made of our definition."""
    return serialize_dynamic(name, definition(EVERY_MESSAGE[name]))[name]


@every_message
def test_damaged_message_is_valid_or_rejected(name: str, mutations: int) -> None:
    cls = EVERY_MESSAGE[name]
    originals = [CODEC.encode(message) for message in samples(name, 30)]
    random = np.random.default_rng(zlib.crc32(name.encode()))
    before = _peak_memory()
    outcomes = {"valid": 0, "rejected": 0}
    for _ in range(mutations):
        message = _decode_or_reject(cls, damaged(originals, random))
        outcomes["rejected" if message is None else "valid"] += 1
        if message is not None:
            assert CODEC.decode(cls, CODEC.encode(message)) == message
            assert constructed(message) == message
    assert min(outcomes.values()) > 0
    assert _peak_memory() - before < 32 * 2**20


def test_rejected_messages_are_freed() -> None:
    for cls in EVERY_MESSAGE.values():
        _decode_or_reject(cls, b"")
    assert _live_errors() == 0


@every_message
def test_memory_is_bounded_by_the_size_of_the_bytes(name: str) -> None:
    cls = EVERY_MESSAGE[name]
    original = CODEC.encode(samples(name, 30)[-1])
    data = original + bytes(400)
    _decode_or_reject(cls, data)
    tracemalloc.start()
    for start in range(4, len(original) - 3, 4):
        for count in (len(data) - start, 2**24, 2**31, 2**32 - 1):
            huge = data[:start] + struct.pack("<I", count) + data[start + 4 :]
            _decode_or_reject(cls, huge)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200_000 + 500 * len(data)


def plain(value: Any) -> Any:
    """Return a message as dictionaries, lists and numbers."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        return value.tolist()
    if hasattr(value, "__ros_type__"):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return [plain(item) for item in value]


def constructed(value: Any) -> Any:
    """Return a message remade by the constructors of its classes, which validate everything."""
    if hasattr(value, "__ros_type__"):
        return type(value)(*[constructed(getattr(value, field.name)) for field in fields(value)])
    if isinstance(value, Packed):
        return Packed(value.element, value.array.copy())
    return tuple(map(constructed, value)) if isinstance(value, tuple) else value


def _decode_or_reject(cls: type[Any], data: bytes) -> Any | None:
    try:
        return CODEC.decode(cls, data)
    except InvalidMessage:
        return None


def _live_errors() -> int:
    gc.collect()
    return sum(type(thing) in (InvalidMessage, SerdeError) for thing in gc.get_objects())


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
