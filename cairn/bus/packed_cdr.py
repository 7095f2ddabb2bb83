"""CDR of packed sequences in one piece: the bytes of a plain sequence, without its objects."""

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import CDRDeser, CDRSer, Msgdef, Nodetype
from rosbags.interfaces import Typestore as TypestoreProtocol
from rosbags.serde import SerdeError
from rosbags.serde.primitives import (
    pack_uint32_be,
    pack_uint32_le,
    unpack_uint32_be,
    unpack_uint32_le,
)

from cairn.schemas.packed import Packed

_NUMBER = 8  # bytes, and alignment, of a float64


def packed_msgdef(name: str, element: type[Any]) -> Msgdef[object]:
    """A definition to stand in a rosbags `Typestore.cache` for "sequence of `element`"."""
    columns = Packed(element).array.shape[1]
    return Msgdef(
        name=name,
        # For the generated code around it: aligned as a sequence of float64.
        fields=[("numbers", (Nodetype.SEQUENCE, ((Nodetype.BASE, ("float64", 0)), 0)))],
        cls=Packed,
        size_cdr=0,
        getsize_cdr=_size,
        serialize_cdr_le=_serializer(pack_uint32_le, "<f8"),
        serialize_cdr_be=_serializer(pack_uint32_be, ">f8"),
        deserialize_cdr_le=_deserializer(element, columns, unpack_uint32_le, "<f8"),
        deserialize_cdr_be=_deserializer(element, columns, unpack_uint32_be, ">f8"),
        size_ros1=0,
        getsize_ros1=_never,
        serialize_ros1=_never,
        deserialize_ros1=_never,
        getsize_ros1_to_cdr=_never,
        ros1_to_cdr=_never,
        getsize_cdr_to_ros1=_never,
        cdr_to_ros1=_never,
    )


def _size(position: int, packed: Any, _: TypestoreProtocol) -> int:
    size: int = packed.array.nbytes
    return _start(position, len(packed)) + size


def _start(position: int, count: int) -> int:
    # After the count; padding to the numbers only if there are any.
    position += 4
    return (position + _NUMBER - 1) & -_NUMBER if count else position


def _serializer(pack: Callable[[memoryview, int, int], None], dtype: str) -> CDRSer:
    def serialize(raw: memoryview, position: int, packed: Any, _: TypestoreProtocol) -> int:
        array = packed.array
        pack(raw, position, len(array))
        start = _start(position, len(array))
        end: int = start + array.nbytes
        raw[start:end] = array.astype(dtype, copy=False).reshape(-1).view(np.uint8)
        return end

    return serialize


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


def _never(*_: Any) -> Any:
    raise NotImplementedError("messages of ROS 1 are not supported")
