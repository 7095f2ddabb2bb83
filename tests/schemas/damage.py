"""Damage encoded messages in ways that reveal missing checks of a decoder."""

import resource
import struct
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cairn.bus.codec import Codec
from cairn.schemas.message import InvalidMessage

Buffers = list[bytes]

_COUNTS = (0, 1, 2, 255, 65_536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
_NUMBERS = (float("nan"), float("inf"), -float("inf"), -1.0, 1e308, -1e308, 5e-324, 1e39)


@dataclass
class Decoded:
    """How many buffers were "valid" and "rejected", and the processor time of the slowest [s]."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0


def damaged(originals: Buffers, random: np.random.Generator) -> bytes:
    """Return one of the buffers with one to four faults."""
    data = bytearray(originals[random.integers(len(originals))])
    for _ in range(random.integers(1, 5)):
        _FAULTS[random.integers(len(_FAULTS))](data, random)
    return bytes(data)


def decode_damaged(codec: Codec, cls: type[Any], originals: Buffers, count: int) -> Decoded:
    """Assert that damaged buffers are valid messages or rejected, in little memory."""
    random = np.random.default_rng(len(originals[0]))
    before = _peak_memory()
    decoded = Decoded()
    for _ in range(count):
        data = damaged(originals, random)
        began = time.thread_time()
        try:
            message = codec.decode(cls, data)
        except InvalidMessage:
            message = None
        decoded.slowest_s = max(decoded.slowest_s, time.thread_time() - began)
        decoded.outcomes["rejected" if message is None else "valid"] += 1
        if message is not None:
            assert codec.decode(cls, codec.encode(message)) == message, data.hex()
    assert _peak_memory() - before < 32 * 2**20
    return decoded


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _flip_bit(data: bytearray, random: np.random.Generator) -> None:
    if data:
        data[random.integers(len(data))] ^= 1 << int(random.integers(8))


def _set_byte(data: bytearray, random: np.random.Generator) -> None:
    if data:
        data[random.integers(len(data))] = int(random.integers(256))


def _set_count(data: bytearray, random: np.random.Generator) -> None:
    _overwrite(data, random, struct.pack("<I", _COUNTS[random.integers(len(_COUNTS))]))


def _set_double(data: bytearray, random: np.random.Generator) -> None:
    _overwrite(data, random, struct.pack("<d", _NUMBERS[random.integers(len(_NUMBERS))]))


def _set_float(data: bytearray, random: np.random.Generator) -> None:
    number = np.float32(_NUMBERS[random.integers(4)])
    _overwrite(data, random, number.tobytes())


def _overwrite(data: bytearray, random: np.random.Generator, value: bytes) -> None:
    words = (len(data) - len(value)) // 4 + 1
    if words > 0:
        start = 4 * int(random.integers(words))
        data[start : start + len(value)] = value


def _truncate(data: bytearray, random: np.random.Generator) -> None:
    del data[random.integers(len(data) + 1) :]


def _extend(data: bytearray, random: np.random.Generator) -> None:
    data += random.bytes(int(random.integers(1, 12)))


def _repeat(data: bytearray, random: np.random.Generator) -> None:
    start, end = sorted(random.integers(len(data) + 1, size=2).tolist())
    data[start:start] = data[start:end][:64]


def _turn_byte_order(data: bytearray, random: np.random.Generator) -> None:
    if len(data) > 1:
        data[1] ^= 1


_FAULTS: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    _flip_bit, _set_byte, _set_byte, _set_count, _set_count, _set_double, _set_double, _set_float,
    _truncate, _extend, _repeat, _turn_byte_order,
)  # fmt: skip
