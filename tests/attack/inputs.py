"""Every input of the simulated robot, and invalid messages for each."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.codec import Codec
from cairn.deployment.load import assemble, read_sources
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import load_plugin
from cairn.deployment.shipped import deployment_file
from cairn.runtime.ports import ports_of
from cairn.schemas.message import InvalidMessage, type_name
from tests.schemas.arbitrary import samples
from tests.schemas.damage import damaged

CODEC: Final = Codec()
_SEED, _TRIES = 17, 1000

DAMAGES: Final = (
    "empty", "header_alone", "no_cdr", "truncated", "nan", "infinite", "huge_number", "huge_count",
    "mutated", "mutated_again",
)  # fmt: skip
"""What is wrong with the messages of `invalid`."""


@dataclass(frozen=True)
class Topic:
    """A topic that components subscribe to: `readers` are pairs of component and port."""

    name: str
    message: type[Any]
    readers: tuple[tuple[str, str], ...]
    exclusive: bool
    """Whether all its readers accept the entitled writer alone."""
    operated: bool
    """Whether the role `operate` may publish on it."""

    @property
    def key(self) -> str:
        """The key expression of its messages."""
        return keys.message_key(0, self.name, self.message)


@cache
def deployment() -> Deployment:
    """Return the deployment of the simulated robot."""
    return assemble(read_sources(deployment_file("sim"), []), [])


@cache
def topics() -> Mapping[str, Topic]:
    """Return all topics that components of the simulated robot subscribe to, by short name."""
    readers: dict[str, list[tuple[str, str]]] = defaultdict(list)
    kinds: dict[str, type[Any]] = {}
    open_to_all, operated = set(), set()
    for member in deployment().members():
        cls = load_plugin(member.spec.plugin)
        for port in ports_of(cls).values():
            if port.direction == "in":
                name = member.spec.topics.get(port.name, port.name)
                readers[name].append((member.name, port.name))
                kinds[name] = port.interface
                open_to_all |= set() if port.exclusive else {name}
                operated |= {name} if port.name in cls.operator_inputs else set()
    return {
        name: Topic(
            full_name("robot", name),
            kinds[name],
            tuple(ports),
            name not in open_to_all,
            name in operated,
        )
        for name, ports in readers.items()
    }


def components() -> tuple[str, ...]:
    """Return the names of all components of the simulated robot."""
    return tuple(member.name for member in deployment().members())


def valid(message: type[Any]) -> bytes:
    """Return a valid message with content, encoded."""
    originals = [CODEC.encode(one) for one in samples(type_name(message), 20)]
    return max(originals, key=len)


@cache
def invalid(topic: Topic) -> Mapping[str, bytes]:
    """Return invalid messages for a topic, by the name of what is wrong with them.

    A damage that messages of its class cannot have is left out.
    """
    message = topic.message
    found = {name: data for name, data in _damages(message) if _is_invalid(message, data)}
    assert len(found) >= 4, f"{type_name(message)}: only {sorted(found)} are invalid"
    return found


def _damages(message: type[Any]) -> Iterator[tuple[str, bytes]]:
    original = valid(message)
    random = np.random.default_rng(_SEED)
    yield "empty", b""
    yield "header_alone", original[:4]
    yield "no_cdr", b"\xff" * 64
    yield "truncated", original[: 4 + (len(original) - 4) // 2]
    numbers = {"nan": float("nan"), "infinite": float("inf"), "huge_number": 1e308}
    for name, number in numbers.items():
        yield name, _overwritten(message, original, struct.pack("<d", number))
    yield "huge_count", _overwritten(message, original, struct.pack("<I", 2**32 - 1))
    for name in ("mutated", "mutated_again"):
        tried = (damaged([original], random) for _ in range(_TRIES))
        yield name, next((data for data in tried if _is_invalid(message, data)), original)


def _overwritten(message: type[Any], original: bytes, value: bytes) -> bytes:
    """Return the message with a value where that makes it invalid; else the message."""
    for at in range(4, len(original) - len(value) + 1, 4):
        data = original[:at] + value + original[at + len(value) :]
        if _is_invalid(message, data):
            return data
    return original


def _is_invalid(message: type[Any], data: bytes) -> bool:
    try:
        CODEC.decode(message, data)
    except InvalidMessage:
        return True
    return False
