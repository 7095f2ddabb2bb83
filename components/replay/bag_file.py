"""Reads the messages of ROS 1 and ROS 2 bags; a ROS 1 bag with a broken index in sequence."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype

from cairn.components.replay.recording import RecordingError
from cairn.components.replay.ros1_sequence import SequentialBag

Choice = Callable[[Mapping[str, str]], Collection[str]]
"""Which topics to read, given the message type (`package/msg/Name`) of each."""

_SUFFIXES = {b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\x00": ".db3"}


@dataclass(frozen=True)
class BagFile:
    """What was read: time of receipt [ns] and message, by topic; and what was lost: sentences.

    `types` and `counts` are those of all topics.
    """

    types: Mapping[str, str]
    counts: Mapping[str, int]
    messages: Mapping[str, list[tuple[int, Any]]]
    notes: list[str]


def read_bag(path: Path, choose: Choice) -> BagFile:
    """The messages of those topics of the bag at `path` that `choose` names.

    `path` is a ROS 1 bag, the folder of a ROS 2 bag, or one of its files. Messages have the
    attributes of their ROS 2 definition. Raises `RecordingError`.
    """
    if _is_ros1(path):
        try:
            # What the library does not read: format 1.2, and bags that are not named so.
            if _is_ros1(path, b"#ROSRECORD") or path.suffix != ".bag":
                return _in_sequence(path, choose, "")
            return _by_index(path, choose)
        except RecordingError:
            raise
        except Exception as error:  # the library fails in any way on a broken bag
            return _in_sequence(path, choose, _told(error))
    _check_suffix(path)
    try:
        return _by_index(path, choose)
    except RecordingError:
        raise
    except Exception as error:  # the library fails in any way on a broken bag
        mend = f"mcap recover {path.name}" if path.suffix == ".mcap" else f"ros2 bag reindex {path}"
        raise RecordingError(
            f"{path} cannot be read as a ROS 2 bag ({_told(error)}). It is cut off, damaged, or "
            f"was not closed when it was recorded: mend it with `{mend}`, or take a fresh copy."
        ) from error


def _by_index(path: Path, choose: Choice) -> BagFile:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        counts = Counter[str]()
        for connection in reader.connections:
            counts[connection.topic] += connection.msgcount
        chosen = choose(types)
        messages: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in chosen}
        connections = [c for c in reader.connections if c.topic in chosen]
        # The library takes no connection at all for every connection.
        for connection, received, raw in reader.messages(connections) if connections else ():
            message = reader.deserialize(raw, connection.msgtype)
            messages[connection.topic].append((received, message))
    return BagFile(types, counts, messages, [])


def _in_sequence(path: Path, choose: Choice, cause: str) -> BagFile:
    """All that can be found in the file from front to back; `cause` is what is wrong with it."""
    sequence = SequentialBag(path)
    found = list(sequence.messages())
    notes = list(sequence.lost)
    if not found:
        raise RecordingError(
            f"{path} holds no message that can be read ({'; '.join([cause, *notes])}). Mend it "
            "with `rosbag reindex`, or take a fresh copy."
        )
    types = {c.topic: normalize_msgtype(c.type) for c, _, _ in found}
    chosen = choose(types)
    messages: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in chosen}
    typestore = get_typestore(Stores.EMPTY)
    for connection in {c.topic: c for c, _, _ in found if c.topic in chosen}.values():
        fields = get_types_from_msg(connection.definition, types[connection.topic])
        if "roslib/msg/Header" in fields:  # its name before 2010's end
            fields["std_msgs/msg/Header"] = fields.pop("roslib/msg/Header")
        typestore.register({t: f for t, f in fields.items() if t not in typestore.fielddefs})
    for number, (connection, received, raw) in enumerate(found, start=1):
        if connection.topic in chosen:
            try:
                message = typestore.deserialize_ros1(raw, types[connection.topic])
            except (struct.error, AssertionError, ValueError, IndexError) as error:
                notes.append(f"message {number} ({connection.topic}) is damaged: {_told(error)}")
                continue
            messages[connection.topic].append((received, message))
    if cause:
        notes.insert(0, f"its index is broken ({cause}): read in sequence, {len(found)} messages")
    return BagFile(types, Counter(c.topic for c, _, _ in found), messages, notes)


def _is_ros1(path: Path, magic: bytes = b"#ROS") -> bool:
    if path.is_dir():
        return False
    with path.open("rb") as stream:
        return stream.read(len(magic)) == magic


def _check_suffix(path: Path) -> None:
    if path.is_dir():
        return
    with path.open("rb") as stream:
        magic = stream.read(16)
    for begins, suffix in _SUFFIXES.items():
        if magic.startswith(begins) and path.suffix != suffix:
            raise RecordingError(
                f"{path} is a {suffix} file: give it a name that ends in {suffix}."
            )


def _told(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
