"""Writes recordings as `cairn record` does, by the library mcap."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition, type_hash
from cairn.schemas.message import type_name
from cairn.schemas.std_msgs import String

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
"""When the recordings begin [ns]."""

CODEC = Codec()
UNLIMITED = "{sec: 2147483647, nsec: 4294967295}"
QOS = (
    "- history: 1\n  depth: 10\n  reliability: 1\n  durability: %d\n"
    f"  deadline: {UNLIMITED}\n  lifespan: {UNLIMITED}\n  liveliness: 1\n"
    f"  liveliness_lease_duration: {UNLIMITED}\n  avoid_ros_namespace_conventions: false\n"
)


@dataclass(frozen=True)
class Sent:
    """A message, when it arrives after `BEGIN` [ns], by whom and how long before it was sent."""

    topic: str
    at_ns: int
    message: Any
    node: str = "/robot/test"
    latched: bool = False
    sequence: int = 0
    delay_ns: int = 1000


def text(value: str) -> String:
    return String(data=value)


def write_recording(
    file: Path,
    sent: Iterable[Sent],
    *,
    chunk_size: int = 1,
    close: bool = True,
    attachments: dict[str, bytes] | None = None,
    **options: Any,
) -> Path:
    """Write a recording; by default each message is in a chunk of its own.

    Without `close` it is as after `kill -9`: without index, summary and end.
    """
    with file.open("wb") as stream:
        options = {"compression": CompressionType.ZSTD} | options
        writer = Writer(stream, chunk_size=chunk_size, **options)
        writer.start("ros2", "cairn")
        channels: dict[tuple[str, str], int] = {}
        counts: dict[int, int] = {}
        for name, content in (attachments or {"run.json": b'{"seed": 7}'}).items():
            writer.add_attachment(BEGIN, BEGIN, name, "application/json", content)
        writer.add_metadata("cairn", {"format": "1"})
        for one in sent:
            key = (one.topic, one.node)
            if key not in channels:
                cls = type(one.message)
                schema = writer.register_schema(type_name(cls), "ros2msg", definition(cls).encode())
                metadata = {
                    "node": one.node,
                    "gid": f"{len(channels):032x}",
                    "type_hash": type_hash(cls),
                    "offered_qos_profiles": QOS % (1 if one.latched else 2),
                    "latched": "true" if one.latched else "false",
                }
                channels[key] = writer.register_channel(one.topic, "cdr", schema, metadata)
            channel = channels[key]
            counts[channel] = one.sequence or counts.get(channel, 0) + 1
            writer.add_message(
                channel,
                BEGIN + one.at_ns,
                CODEC.encode(one.message),
                BEGIN + one.at_ns - one.delay_ns,
                counts[channel],
            )
        if close:
            writer.finish()
    return file
