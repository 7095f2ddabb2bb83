"""The messages of ROS 1 bags, ROS 2 bags and MCAP files that are replayed, with their types.

`bag_files` reads the files.
"""

from __future__ import annotations

import math
import sqlite3
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from cairn import SECOND, from_ns, to_ns
from cairn.bus.codec import Codec
from cairn.components.replay_devices.bag_files import (
    MOST_DAMAGES,
    BagFile,
    BagTopic,
    NotSupported,
)
from cairn.errors import RecordingError
from cairn.limits.files import megabytes
from cairn.limits.sqlite import SchemaError
from cairn.limits.yaml import yaml_fault
from cairn.planar.scans import has_directions
from cairn.schemas.cairn_msgs import RecognizedObjectArray, VisualMap
from cairn.schemas.message import InvalidMessage, received_message, type_name
from cairn.schemas.sensor_msgs import CameraInfo, LaserScan
from cairn.schemas.std_msgs import Header

SCAN_TYPE: Final = "sensor_msgs/msg/LaserScan"
ECHOES_TYPE: Final = "sensor_msgs/msg/MultiEchoLaserScan"
ODOMETRY_TYPE: Final = "nav_msgs/msg/Odometry"
TRANSFORM_TYPES: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""The types of topics of transforms, in ROS 2 and in ROS 1."""

POSE_TYPES: Final = {
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
    ODOMETRY_TYPE: lambda message: message.pose.pose,
}
OBJECTS_TYPE = type_name(RecognizedObjectArray)
MAP_TYPE = type_name(VisualMap)
INFO_TYPE = type_name(CameraInfo)
# Are decoded to Cairn's classes.
_OWN = {OBJECTS_TYPE: RecognizedObjectArray, MAP_TYPE: VisualMap, INFO_TYPE: CameraInfo}
_READ = (
    SCAN_TYPE,
    ECHOES_TYPE,
    ODOMETRY_TYPE,
    *TRANSFORM_TYPES,
    *POSE_TYPES,
    OBJECTS_TYPE,
    MAP_TYPE,
)
TEXT_TYPE, _DESCRIPTION = "std_msgs/msg/String", "robot_description"


_KEPT_BYTES: Final = 200_000_000
_KEPT_RATIO: Final = 60
_MESSAGE_COST: Final = 3_000  # what a message takes beside its serialized bytes, about [bytes]
_TF_FACTOR: Final = 20  # what a transform takes in relation to its serialized bytes


@dataclass(frozen=True)
class BagContents:
    """Messages with their times of receipt [ns], by topic; `notes` say what was lost.

    `types` and `counts` are those of all topics.
    """

    types: Mapping[str, str]
    counts: Mapping[str, int]
    messages: Mapping[str, list[tuple[int, Any]]]
    notes: list[str]


def read_bag(path: Path) -> BagContents:
    """Read the scans, odometry, transforms, poses and robot's description of the bag at `path`.

    `path` is a ROS 1 bag, the folder of a ROS 2 bag, or one of its files. Messages have the
    attributes of their ROS 2 definition. Raises `RecordingError`.
    """
    bag = BagFile(path)
    messages: dict[str, list[tuple[int, Any]]] = {}
    damaged: list[str] = []
    kept = 0
    with _explained(bag):
        for topic, received, raw in bag.messages(_is_read):
            kept += _MESSAGE_COST + len(raw) * (_TF_FACTOR if topic.type in TRANSFORM_TYPES else 1)
            most = max(_KEPT_BYTES, _KEPT_RATIO * bag.size)
            if kept > most:
                raise RecordingError(
                    f"{path}: its messages would take more than {megabytes(most)} MB of memory, "
                    "the limit for a bag of its size. Replay a part of it."
                )
            try:
                message = deserialize(topic, raw)
            except SerdeError as error:
                damaged.append(f"a message of {topic.name} is damaged: {error_text(error)}")
                if len(damaged) > MOST_DAMAGES:
                    raise
                continue
            messages.setdefault(topic.name, []).append((received, message))
        if not bag.counts.total() and bag.lost:
            raise ValueError("; ".join(["it holds no message that can be read", *bag.lost[:5]]))
        if not bag.counts.total():
            raise RecordingError(f"{path} holds no message: nothing was recorded")
        if damaged and not messages:
            raise ValueError(damaged[0])
    for of in messages.values():
        of.sort(key=lambda pair: pair[0])  # files are almost in this order
    notes = [*bag.lost, *damaged]
    if len(notes) > _MOST_NOTES:
        notes = [*notes[:_MOST_NOTES], f"{len(notes) - _MOST_NOTES} more damages of this kind"]
    counts: dict[str, int] = {}
    for topic, count in bag.counts.items():
        counts[topic.name] = counts.get(topic.name, 0) + count
    types = {topic.name: topic.type for topic in bag.counts}
    chosen = {topic.name: messages.get(topic.name, []) for topic in bag.counts}
    return BagContents(types, counts, chosen, notes)


_MOST_NOTES: Final = 20


def _is_read(topic: BagTopic) -> bool:
    return topic.type in _READ or is_description(topic)


def is_description(topic: BagTopic) -> bool:
    """Return whether a topic has the robot's description (URDF)."""
    return topic.type == TEXT_TYPE and topic.name.rpartition("/")[2] == _DESCRIPTION


@contextmanager
def _explained(bag: BagFile) -> Iterator[None]:
    """Turn errors of reading a bag into `RecordingError` with the file and a remedy."""
    try:
        yield
    except RecordingError:
        raise
    except UNREADABLE as error:
        path = bag.path
        why = error_text(error)
        if isinstance(error, SchemaError):
            raise RecordingError(
                f"{path} is a database, but not a ROS 2 bag ({why}). Give a recording."
            ) from error
        if isinstance(error, NotSupported):
            raise RecordingError(
                f"{path}: {why}, which is not supported; convert it with its own tools, such as "
                "`ros2 bag convert`."
            ) from error
        kind = "ROS 1" if bag.is_ros1 else "ROS 2"
        raise RecordingError(
            f"{path} cannot be read as a {kind} bag ({why}). It is cut off, damaged, or was not "
            f"closed after recording: {_repair(bag, error)}take a fresh copy."
        ) from error


def _repair(bag: BagFile, error: Exception) -> str:
    """Return which command may repair a bag; "" if none does."""
    command = ""
    if bag.is_ros1:
        command = "rosbag reindex"
    elif isinstance(error, sqlite3.Error):
        command = "sqlite3 FILE .recover | sqlite3 NEW_FILE"
    elif bag.path.suffix == ".mcap":
        command = f"mcap recover {bag.path.name}"
    elif "metadata.yaml" in error_text(error):
        command = f"ros2 bag reindex {bag.path}"
    return f"repair it with `{command}`, or " if command else ""


UNREADABLE: Final = (
    ValueError, OSError, struct.error, sqlite3.Error, yaml.YAMLError, SerdeError,
)  # fmt: skip
"""What reading a damaged bag raises, beside `RecordingError`."""


def error_text(error: Exception) -> str:
    """Return one of the `UNREADABLE` errors in one line of words."""
    if isinstance(error, yaml.YAMLError):
        position, fault = yaml_fault(error)
        return f"metadata.yaml{position}: {fault}"
    if isinstance(error, OSError):
        name = f"{Path(error.filename).name}: " if error.filename else ""
        return f"{name}{error.strerror or error}"
    return " ".join(str(error).split())[:500] or type(error).__name__


@cache
def _typestore(is_ros1: bool) -> Typestore:
    """Return the definitions of ROS; those in a bag are not used, because they are code to run."""
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    humble = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    transforms = humble[TRANSFORM_TYPES[0]]
    store.register({name: transforms for name in TRANSFORM_TYPES if name not in store.fielddefs})
    return store


@cache
def _codec() -> Codec:
    return Codec()


@cache
def _md5(type_name: str) -> str:
    return str(_typestore(is_ros1=True).generate_msgdef(type_name)[1])


def deserialize(topic: BagTopic, raw: bytes) -> Any:
    """Return a message; raise `SerdeError` if it is damaged, `ValueError` for an unknown type."""
    store = _typestore(topic.is_ros1)
    own = _OWN.get(topic.type)
    if own is not None and not topic.is_ros1:
        try:
            return _codec().decode(own, raw)
        except InvalidMessage as error:
            raise SerdeError(error_text(error)) from error
    if topic.type not in store.fielddefs:
        raise NotSupported(f"{topic.name} has the unknown type {topic.type[:100]!r}")
    if topic.is_ros1 and topic.md5 not in ("", "*", _md5(topic.type)):
        raise NotSupported(
            f"{topic.name} has the type {topic.type}, but another definition of it (MD5 "
            f"{topic.md5[:40]!r}) than ROS"
        )
    try:
        if topic.is_ros1:
            return store.deserialize_ros1(raw, topic.type)
        return store.deserialize_cdr(raw, topic.type)
    except (AssertionError, IndexError, MemoryError) as error:
        raise SerdeError(error_text(error)) from error


def usual_topic(kind: str, topics: Sequence[str]) -> str | None:
    """Return the topic of the default name, `/scan` or the only `/.../scan`; else None."""
    if f"/{kind}" in topics:
        return f"/{kind}"
    found = [topic for topic in topics if topic.endswith(f"/{kind}")]
    return found[0] if len(found) == 1 else None


class NothingMeasured(ValueError):
    """A message is valid, and of no use."""


def scan_of(stamp: int, m: Any, upside_down: bool) -> LaserScan:
    """Return a message of ROS as a scan with a time [ns], mirrored if the scanner is upside down.

    Of several echoes, the nearest counts. It is repaired like one on the bus. Raises
    `InvalidMessage`, `ValueError`; `NothingMeasured` means a valid scan.
    """
    if not len(m.ranges):
        raise NothingMeasured("it has no ranges")
    ranges, intensities = m.ranges, m.intensities
    if hasattr(ranges[0], "echoes"):
        ranges = [one.echoes[0] if len(one.echoes) else math.inf for one in ranges]
        intensities = ()
    side = -1.0 if upside_down else 1.0  # it turns to the right: the first beam is the left one
    numbers = ("time_increment", "scan_time", "range_min", "range_max")
    values = {
        "header": Header(stamp=from_ns(stamp), frame_id="laser"),
        "ranges": np.asarray(ranges, dtype=np.float32),
        "intensities": np.asarray(intensities, dtype=np.float32),
        **{
            f"angle_{n}": side * float(getattr(m, f"angle_{n}"))
            for n in ("min", "max", "increment")
        },
        **{name: float(getattr(m, name)) for name in numbers},
    }
    scan = received_message(LaserScan, values)
    if not has_directions(scan):
        raise ValueError("its beams have one direction: angle_increment is 0")
    return scan


# Stamps that are further from the time of receipt than this are of another clock [ns].
_CLOCK_TOLERANCE = 60 * SECOND


def clock_offset(received: Sequence[tuple[int, Any]]) -> int:
    """Return by how much the times of receipt [ns] are ahead of the stamps, as a rule.

    `received` are the times of receipt [ns] and the stamps (builtin_interfaces/Time).
    """
    ahead = sorted(receipt - to_ns(stamp) for receipt, stamp in received)
    return ahead[len(ahead) // 2]


def is_same_clock(offset: int, other: int) -> bool:
    """Return whether two offsets [ns] between stamps and times of receipt are of one clock."""
    return abs(offset - other) <= _CLOCK_TOLERANCE


def message_stamps(
    topic: str, received: Sequence[tuple[int, Any]], offset: int = 0
) -> tuple[list[int], str]:
    """Return the stamps [ns] of a topic's messages, and a note, or "".

    Those of another clock than the recording's are replaced by the times of receipt, which are
    ahead of its stamps by `offset` [ns].

    `received` are the times of receipt [ns] and the stamps (builtin_interfaces/Time).
    """
    if not received:
        return [], ""
    stamps = [to_ns(stamp) for _, stamp in received]
    receipts = [receipt for receipt, _ in received]
    if min(receipts) == max(receipts) and min(stamps) < max(stamps):
        return stamps, f"messages of {topic} have no times of receipt: their stamps are used"
    if not is_same_clock(clock_offset(received), offset):
        return receipts, (
            f"stamps on {topic} are from another clock than the bag's (the first is "
            f"{stamps[0] / SECOND:g} s): the times of receipt are used instead"
        )
    if offset:
        return stamps, ""
    pairs = zip(receipts, stamps, strict=True)
    wrong = [k for k, (receipt, stamp) in enumerate(pairs) if not is_same_clock(receipt, stamp)]
    for k in wrong:
        stamps[k] = receipts[k]
    note = f"{len(wrong)} stamps on {topic} are wrong: the times of receipt are used instead"
    return stamps, note if wrong else ""
