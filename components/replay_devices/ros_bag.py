"""ROS 1 bags, ROS 2 bags and MCAP files: their messages, and the streams that they hold.

Images are read from the file as they are replayed: all at once would fill the memory. `bag_files`
reads the files.
"""

from __future__ import annotations

import math
import sqlite3
import struct
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from cairn import SECOND, CairnError, from_ns
from cairn.bus.codec import Codec
from cairn.components.replay_devices.bag_files import BagFile, BagTopic
from cairn.components.replay_devices.record_times import TimeQuality, time_quality
from cairn.components.replay_devices.recording import (
    BAD_SHARE,
    FEW_BAD,
    Gray,
    ImageStream,
    ObservationStream,
    OdometryStream,
    RecordedTopic,
    ScannerMount,
    ScanStream,
    TimedPoses,
    covariances_of,
)
from cairn.components.replay_devices.scanner_mount import (
    BASES,
    FrameLink,
    find_mount,
    links_of_description,
    links_of_transforms,
)
from cairn.components.replay_devices.wheel_odometry import odometry_deviations, odometry_velocities
from cairn.errors import RecordingError
from cairn.limits.files import megabytes
from cairn.limits.sqlite import SchemaError
from cairn.limits.yaml import yaml_fault
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import RecognizedObjectArray, VisualMap
from cairn.schemas.geometry_msgs import Point, Quaternion
from cairn.schemas.geometry_msgs import Pose as PoseMessage
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.sensor_msgs import CameraInfo, Image, LaserScan
from cairn.schemas.std_msgs import Header
from cairn.vision.image_files import camera_of
from cairn.vision.images import decode, gray_of

Array = NDArray[np.float64]
Item = TypeVar("Item")
T = TypeVar("T")
Received = Sequence[tuple[int, Any]]
"""Messages with their times of receipt [ns]."""

SCAN_TYPE: Final = "sensor_msgs/msg/LaserScan"
ODOMETRY_TYPE: Final = "nav_msgs/msg/Odometry"
TRANSFORM_TYPES: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""The types of topics of transforms, in ROS 2 and in ROS 1."""

_POSE_TYPES = {
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
    ODOMETRY_TYPE: lambda message: message.pose.pose,
}
_OBJECTS = type_name(RecognizedObjectArray)
_MAP = type_name(VisualMap)
_INFO = type_name(CameraInfo)
# Are decoded to Cairn's classes.
_OWN = {_OBJECTS: RecognizedObjectArray, _MAP: VisualMap, _INFO: CameraInfo}
_READ = (SCAN_TYPE, ODOMETRY_TYPE, *TRANSFORM_TYPES, *_POSE_TYPES, _OBJECTS, _MAP)
_TEXT, _DESCRIPTION = "std_msgs/msg/String", "robot_description"


class BagRecording:
    """The bag at `path`; `topics` names its topics for `scan`, `odom`, `truth` if ambiguous.

    Of several topics of a type, the one with the default name is replayed, of any robot:
    `/robot/scan`. Only recordings of Cairn hold observations of landmarks and a surveyed map. Scans
    get a time `scan_delay_s` [s] before their stamp; those of a scanner that is mounted upside down
    get its angles mirrored.
    """

    def __init__(self, path: Path, topics: Mapping[str, str], scan_delay_s: float = 0.0) -> None:
        """Read everything but the images; raises `RecordingError`."""
        self._path = path
        self._named = {kind: "/" + name.lstrip("/") for kind, name in topics.items()}
        bag = read_bag(path)
        self._types = {"/" + topic.lstrip("/"): kind for topic, kind in bag.types.items()}
        self._messages = {"/" + topic.lstrip("/"): of for topic, of in bag.messages.items()}
        self._counts = {"/" + topic.lstrip("/"): count for topic, count in bag.counts.items()}
        self._notes = bag.notes
        self._scan_delay = round(scan_delay_s * SECOND)
        scan, odom = self._topic("scan", (SCAN_TYPE,)), self._topic("odom", (ODOMETRY_TYPE,))
        truth = self._topic("truth", tuple(_POSE_TYPES)) if "truth" in self._named else None
        truth = truth or self._usual("truth", tuple(_POSE_TYPES))
        objects = self._usual("recognized_objects", (_OBJECTS,))
        surveyed = self._usual("true_map", (_MAP,))
        self._quality: dict[str, TimeQuality] = {}
        self._mount = self._find_mount(scan, odom)
        self._scans = self._read("scan", scan, self._to_scan, self._to_scans)
        self._odometry = self._read("odom", odom, _odometry_step, _odometry_stream)
        self._objects = self._read("objects", objects, _unchanged, _observations)
        maps = self._messages.get(surveyed or "", [])
        self._landmark_map: VisualMap | None = maps[-1][1] if maps else None
        kinds = {"scan": scan, "odom": odom, "objects": objects}
        self._replayed = {topic: kind for kind, topic in kinds.items() if topic}
        if self._odometry is None:
            transforms = self._transforms()
            self._odometry = self._from_tf(
                [pair for messages in transforms.values() for pair in messages]
            )
            if self._odometry is not None:
                self._replayed |= dict.fromkeys(transforms, "odom")
        self._truth = self._read("truth", truth, _true_pose, _timed_poses)
        if truth is not None:
            self._replayed[truth] = "truth"
        self._image_topics, notes = image_topics(path, self._types, self._named)
        self._notes += notes
        self._replayed |= dict.fromkeys(self._image_topics, "images")
        if self._scans is None and self._odometry is None and not self._image_topics:
            raise RecordingError(
                f"{path} holds neither laser scans, odometry nor images: nothing to replay. "
                "Its topics are "
                f"{', '.join(f'{t} ({kind})' for t, kind in sorted(self._types.items()))}."
            )

    def span(self) -> tuple[int, int]:
        """Return the times [ns] of the first and the last scan or odometry, else image."""
        both = [stream.stamps for stream in (self._scans, self._odometry) if stream is not None]
        images = None if both else self.images()
        if images is not None:
            return images.stamps[0], images.stamps[-1]
        return min(stamps[0] for stamps in both), max(stamps[-1] for stamps in both)

    def odometry(self) -> OdometryStream | None:
        """Return odometry messages, else transforms from frame odom to the robot's base."""
        return self._odometry

    def scans(self) -> ScanStream | None:
        """Return the laser's scans."""
        return self._scans

    def mount(self) -> ScannerMount | None:
        """Return the scanner's pose by static transforms, else by the robot's description."""
        return self._mount

    def observations(self) -> ObservationStream | None:
        """Return the observations in a recording of Cairn: ROS has no message for them."""
        return self._objects

    def images(self) -> ImageStream | None:
        """Return the images of a camera's topic, or of a stereo camera's two."""
        if not self._image_topics:
            return None
        images, notes = bag_images(self._path, self._image_topics)
        self._notes += [note for note in notes if note not in self._notes]
        infos = [self._calibration(topic) for topic in self._image_topics]
        return replace(images, infos=tuple(infos))

    def _calibration(self, image_topic: str) -> CameraInfo | None:
        """Return the first calibration of a camera: `left_info` of `left_image`, or ROS's name."""
        namespace, _, name = image_topic.rpartition("/")
        for topic in (f"{namespace}/{name.replace('image', 'info')}", f"{namespace}/camera_info"):
            if self._types.get(topic) == _INFO:
                return first_calibration(self._path, topic)
        return None

    def truth(self) -> TimedPoses | None:
        """Return the poses of the topic that `topics` names for them, or of topic `truth`."""
        return self._truth

    def landmark_map(self) -> VisualMap | None:
        """Return the surveyed map in a recording of Cairn."""
        return self._landmark_map

    def topics(self) -> Sequence[RecordedTopic]:
        """Return the bag's topics."""
        return [
            RecordedTopic(self._replayed.get(topic), topic, kind, self._counts.get(topic, 0))
            for topic, kind in sorted(self._types.items())
        ]

    def time_quality(self) -> Mapping[str, TimeQuality]:
        """Return the quality of the stamps, in the order in which the messages were received."""
        return self._quality

    def notes(self) -> Sequence[str]:
        """Return what was lost or assumed."""
        return self._notes

    def _topic(self, kind: str, types: Sequence[str]) -> str | None:
        """Return the topic to replay, None if the bag has none of that kind."""
        found = sorted(topic for topic, kind in self._types.items() if kind in types)
        named = self._named.get(kind)
        if named is not None:
            if named in found:
                return named
            if kind == "odom" and self._types.get(named) in TRANSFORM_TYPES:
                return None
            raise RecordingError(
                f"{self._path}: topics.{kind} = {named} is not a topic of {' or '.join(types)}; "
                f"there {'are ' + ', '.join(found) if found else 'is nothing'}."
            )
        usual = usual_topic(kind, found)
        if usual is None and len(found) > 1:
            raise RecordingError(
                f"{self._path} has several topics of {types[0]}: {', '.join(found)}. Name one "
                f"with the parameter topics.{kind} of a replay, or with --{kind} of the command."
            )
        return usual or next(iter(found), None)

    def _usual(self, kind: str, types: Sequence[str]) -> str | None:
        return usual_topic(kind, [topic for topic, of in self._types.items() if of in types])

    def _transforms(self) -> dict[str, list[tuple[int, Any]]]:
        """Return the messages of transforms by topic, those of static ones first."""
        topics = [topic for topic in self._messages if self._types[topic] in TRANSFORM_TYPES]
        topics.sort(key=lambda topic: not topic.endswith("tf_static"))
        return {topic: self._messages[topic] for topic in topics}

    def _find_mount(self, scan: str | None, odom: str | None) -> ScannerMount | None:
        """Return the scanner's mount on the frame that odometry moves, else on another base."""
        scans = self._messages.get(scan or "", [])
        if not scans:
            return None
        odometry = self._messages.get(odom or "", [])
        moved = [message.child_frame_id for _, message in odometry[:1]]
        links = [
            link
            for topic, received in self._transforms().items()
            for link in links_of_transforms(topic, (t for _, m in received for t in m.transforms))
        ]
        frame = scans[0][1].header.frame_id
        found = find_mount(links, self._described_links, frame, moved)
        if isinstance(found, str):
            self._notes.append(found)
            return None
        return found

    def _described_links(self) -> list[FrameLink]:
        """Return the links of the robot's description; of several, that of the shortest name."""
        described = [topic for topic in self._messages if self._types[topic] == _TEXT]
        topic = min(described, key=lambda topic: (len(topic), topic), default="")
        received = self._messages.get(topic, [])
        if not received:
            return []
        try:
            return links_of_description(topic, received[-1][1].data)
        except RecordingError as error:
            self._notes.append(str(error))
            return []

    def _read(
        self,
        kind: str,
        topic: str | None,
        parse: Callable[[int, Any], Item],
        gather: Callable[[list[int], list[Item]], T],
    ) -> T | None:
        """Gather the parsed messages of a topic by their stamps in order; None if there are none.

        Invalid messages are left out and noted. Raises `RecordingError` if they are too many.
        """
        received = self._messages.get(topic, []) if topic else []
        if not received:
            return None
        stamps = self._stamps(topic or "", [(at, m.header.stamp) for at, m in received])
        self._quality[kind] = time_quality(stamps)
        parsed: list[Item] = []
        known: list[int] = []
        faults: list[str] = []
        for k in sorted(range(len(stamps)), key=stamps.__getitem__):
            try:
                parsed.append(parse(stamps[k], received[k][1]))
                known.append(stamps[k])
            except (InvalidMessage, ValueError) as error:
                faults.append(f"message {k + 1}: {error}")
        if len(faults) > max(FEW_BAD, BAD_SHARE * len(stamps)) or not parsed:
            raise RecordingError(
                f"{self._path}, topic {topic}: {faults[0]}. {len(faults)} of {len(stamps)} "
                "messages are invalid, which cannot be replayed: name another topic, or remove "
                "them from the bag."
            )
        if faults:
            self._notes.append(
                f"{len(faults)} of {len(stamps)} messages of {topic} are invalid and left out: "
                f"{faults[0]}{'; ...' if len(faults) > 1 else ''}"
            )
        return gather(known, parsed)

    def _stamps(self, topic: str, received: Sequence[tuple[int, Any]]) -> list[int]:
        stamps, note = message_stamps(topic, received)
        self._notes += [note] if note else []
        return stamps

    def _to_scan(self, stamp: int, message: Any) -> LaserScan:
        upside_down = self._mount is not None and self._mount.upside_down
        return scan_of(self._undelayed(stamp), message, upside_down)

    def _to_scans(self, stamps: list[int], scans: list[LaserScan]) -> ScanStream:
        return ScanStream([self._undelayed(stamp) for stamp in stamps], scans, stamps)

    def _undelayed(self, stamp: int) -> int:
        return max(stamp - self._scan_delay, 0)

    def _from_tf(self, received: Received) -> OdometryStream | None:
        """Return odometry from transforms of frame odom to the base."""
        pairs = [
            (at, transform)
            for at, message in received
            for transform in message.transforms
            if transform.header.frame_id.strip("/") == "odom"
            and transform.child_frame_id.strip("/") in BASES
        ]
        if not pairs:
            return None
        stamps = self._stamps("/tf", [(at, t.header.stamp) for at, t in pairs])
        self._quality["odom"] = time_quality(stamps)
        order = sorted(range(len(stamps)), key=stamps.__getitem__)
        stamps = [stamps[k] for k in order]
        poses = np.array([_transform_pose(pairs[k][1].transform) for k in order])
        self._notes.append("odometry is computed from the transforms of frame odom")
        covariances = covariances_of(odometry_deviations(poses))
        return OdometryStream(stamps, poses, covariances, odometry_velocities(stamps, poses))


def usual_topic(kind: str, topics: Sequence[str]) -> str | None:
    """Return the topic of the default name, `/scan` or the only `/.../scan`; else None."""
    if f"/{kind}" in topics:
        return f"/{kind}"
    found = [topic for topic in topics if topic.endswith(f"/{kind}")]
    return found[0] if len(found) == 1 else None


def scan_of(stamp: int, m: Any, upside_down: bool) -> LaserScan:
    """Return a message of ROS as a scan with a time [ns], mirrored if the scanner is upside down.

    Raises `InvalidMessage`, `ValueError`.
    """
    beams = len(m.ranges)
    side = -1.0 if upside_down else 1.0  # it turns to the right: the first beam is the left one
    return LaserScan(
        header=Header(stamp=from_ns(stamp), frame_id="laser"),
        angle_min=side * float(m.angle_min),
        angle_max=side * float(m.angle_max),
        angle_increment=side * float(m.angle_increment),
        time_increment=float(m.time_increment),
        scan_time=float(m.scan_time),
        range_min=float(m.range_min),
        range_max=float(m.range_max),
        ranges=np.asarray(m.ranges, dtype=np.float32),
        # Some drivers send another number of intensities, which belong to no beam.
        intensities=np.asarray(m.intensities if len(m.intensities) == beams else [], np.float32),
    )


@dataclass(frozen=True)
class _OdometryStep:
    """A message of odometry: pose, covariance (3, 3) as it is, forward and turning velocity."""

    pose: Pose
    covariance: Array
    twist: tuple[float, float]


def _odometry_step(_: int, message: Any) -> _OdometryStep:
    covariance = np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)
    twist = (float(message.twist.twist.linear.x), float(message.twist.twist.angular.z))
    if not all(map(math.isfinite, twist)):
        raise ValueError(f"its velocity is {twist[0]:g} m/s, {twist[1]:g} rad/s")
    return _OdometryStep(_pose(message.pose.pose), covariance[[0, 1, 5]][:, [0, 1, 5]], twist)


def _odometry_stream(stamps: list[int], steps: list[_OdometryStep]) -> OdometryStream:
    poses = np.array([step.pose for step in steps])
    covariances = np.array([step.covariance for step in steps])
    if not covariances.any() or not np.isfinite(covariances).all():
        covariances = covariances_of(odometry_deviations(poses))
    return OdometryStream(stamps, poses, covariances, np.array([step.twist for step in steps]))


def _unchanged(_: int, message: RecognizedObjectArray) -> RecognizedObjectArray:
    return message


def _observations(stamps: list[int], messages: list[RecognizedObjectArray]) -> ObservationStream:
    return ObservationStream(stamps, (), messages)


def _true_pose(_: int, message: Any) -> Pose:
    return _pose(_POSE_TYPES[message.__msgtype__](message))


def _timed_poses(stamps: list[int], poses: list[Pose]) -> TimedPoses:
    return TimedPoses(stamps, np.array(poses))


def _pose(pose: Any) -> Pose:
    return _pose_of(pose.position, pose.orientation)


def _transform_pose(transform: Any) -> Pose:
    return _pose_of(transform.translation, transform.rotation)


def _pose_of(position: Any, rotation: Any) -> Pose:
    message = PoseMessage(
        position=Point(x=float(position.x), y=float(position.y)),
        orientation=Quaternion(
            x=float(rotation.x), y=float(rotation.y), z=float(rotation.z), w=float(rotation.w)
        ),
    )
    return planar_pose(message)


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
                message = deserialize(bag, topic, raw)
            except SerdeError as error:
                if not bag.is_ros1:
                    raise
                damaged.append(f"a message of {topic.name} is damaged: {error_text(error)}")
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
    return topic.type == _TEXT and topic.name.rpartition("/")[2] == _DESCRIPTION


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
        if bag.is_ros1:
            raise RecordingError(
                f"{path} cannot be read as a ROS 1 bag ({why}). It is cut off or damaged: repair "
                "it with `rosbag reindex`, or take a fresh copy."
            ) from error
        repair = f"mcap recover {path.name}" if _is_mcap(path) else f"ros2 bag reindex {path}"
        raise RecordingError(
            f"{path} cannot be read as a ROS 2 bag ({why}). It is cut off, damaged, or was not "
            f"closed after recording: repair it with `{repair}`, or take a fresh copy."
        ) from error


UNREADABLE: Final = (
    ValueError, OSError, struct.error, sqlite3.Error, yaml.YAMLError, SerdeError,
)  # fmt: skip
"""What reading a damaged bag raises, beside `RecordingError`."""


def _is_mcap(path: Path) -> bool:
    return path.suffix == ".mcap"


def error_text(error: Exception) -> str:
    """Return one of the `UNREADABLE` errors in one line of words."""
    if isinstance(error, yaml.YAMLError):
        position, fault = yaml_fault(error)
        return f"metadata.yaml{position}: {fault}"
    if isinstance(error, OSError):
        return str(error.strerror or error)
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


def deserialize(bag: BagFile, topic: BagTopic, raw: bytes) -> Any:
    """Return a message; raise `SerdeError` if it is damaged, `ValueError` for an unknown type."""
    store = _typestore(bag.is_ros1)
    own = _OWN.get(topic.type)
    if own is not None and not bag.is_ros1:
        try:
            return _codec().decode(own, raw)
        except InvalidMessage as error:
            raise SerdeError(error_text(error)) from error
    if topic.type not in store.fielddefs:
        raise ValueError(f"{topic.name} has the type {topic.type[:100]!r}, which is not known")
    if bag.is_ros1 and topic.md5 not in ("", "*", _md5(topic.type)):
        raise ValueError(
            f"{topic.name} has the type {topic.type}, but another definition of it (MD5 "
            f"{topic.md5[:40]!r}) than ROS"
        )
    try:
        if bag.is_ros1:
            return store.deserialize_ros1(raw, topic.type)
        return store.deserialize_cdr(raw, topic.type)
    except (AssertionError, IndexError, MemoryError) as error:
        raise SerdeError(error_text(error)) from error


IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""The types of topics that hold images."""

# Images of a pair differ by less than this [ns].
_PAIR_TOLERANCE = SECOND // 100


def image_topics(
    path: Path, types: Mapping[str, str], named: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """Return the topics of the left (or only) and of the right camera, with notes.

    `types` are those of the bag's topics, `named` the topics named for left_image and right_image.
    None is returned if the bag has no images, or the choice is ambiguous. Raises `RecordingError`
    if a named topic holds no images.
    """
    found = sorted(topic for topic, kind in types.items() if kind in IMAGE_TYPES)
    requested = [named[key] for key in ("left_image", "right_image") if key in named]
    for topic in requested:
        if topic not in found:
            raise RecordingError(
                f"{path}: {topic} is not a topic of images; there "
                f"{'are ' + ', '.join(found) if found else 'is nothing'}."
            )
    if requested or len(found) <= 1:
        return requested or found, []
    sides = {side: [t for t in found if _camera_of_topic(t) == side] for side in ("left", "right")}
    if all(len(topics) == 1 for topics in sides.values()):
        return [*sides["left"], *sides["right"]], []
    return [], [
        f"several topics hold images, so none is replayed: {', '.join(found)}; name one with the "
        "parameter topics.left_image, and the right one of a stereo camera with topics.right_image"
    ]


def bag_images(path: Path, topics: list[str]) -> tuple[ImageStream, list[str]]:
    """Return the images of one topic, or the pairs of two, with notes on what is left out.

    Raises `RecordingError` if they cannot be read.
    """
    notes: list[str] = []
    times = [_image_times(path, topic, notes) for topic in topics]
    chosen = [list(times[0])]
    if len(topics) == 2:
        chosen = _paired(*times)
        unpaired = sum(len(stamps) for stamps in times) - 2 * len(chosen[0])
        if unpaired:
            notes.append(f"{unpaired} images have no partner, left out")
    if not chosen[0]:
        raise RecordingError(
            f"{path} holds no {'pairs of ' * (len(topics) == 2)}images on {' and '.join(topics)}"
            + (" within 10 ms of each other." if len(topics) == 2 else ".")
        )
    height, width = _first_whole(
        _SequentialImages(path, topics[0], chosen[0]), len(chosen[0])
    ).shape
    readers = [
        _SequentialImages(path, topic, numbers)
        for topic, numbers in zip(topics, chosen, strict=True)
    ]

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(reader.image(index) for reader in readers)

    stamps = [times[0][number] for number in chosen[0]]
    return ImageStream(" and ".join(topics), stamps, len(topics), (width, height), load), notes


def first_calibration(path: Path, topic: str) -> CameraInfo | None:
    """Return the first message of a topic of a ROS 2 bag; None if there is none."""
    _, message = next(_messages_of(path, topic), (0, None))
    return message if isinstance(message, CameraInfo) else None


class _SequentialImages:
    """Images of one topic by their numbers, which must not decrease."""

    def __init__(self, path: Path, topic: str, numbers: list[int]) -> None:
        self._name = f"{path}, topic {topic}"
        self._numbers = numbers
        self._messages = enumerate(_messages_of(path, topic))

    def image(self, index: int) -> Gray:
        for number, (_, message) in self._messages:
            if number == self._numbers[index]:
                return _gray(self._name, number, message)
        raise RecordingError(f"{self._name} ends before image {index + 1}")


def _first_whole(images: _SequentialImages, count: int) -> Gray:
    """Return the first image that is not damaged; raises `RecordingError` if there is none."""
    for index in range(count - 1):
        with suppress(RecordingError):
            return images.image(index)
    return images.image(count - 1)


def _messages_of(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield the messages of a topic with their times of receipt [ns]."""
    bag = BagFile(path)
    try:
        for found, received, raw in bag.messages(lambda of: "/" + of.name.lstrip("/") == topic):
            yield received, deserialize(bag, found, raw)
    except UNREADABLE as error:
        raise RecordingError(
            f"{path}: it cannot be read ({error_text(error)}): repair the bag with "
            "`rosbag reindex`, `ros2 bag reindex` or `mcap recover`"
        ) from error


def _image_times(path: Path, topic: str, notes: list[str]) -> dict[int, int]:
    """Return the stamps [ns] of a topic's images by their numbers; notes on those left out."""
    received = [(receipt, message.header.stamp) for receipt, message in _messages_of(path, topic)]
    stamps, note = message_stamps(topic, received)
    notes += [note] if note else []
    times: dict[int, int] = {}
    newest = -1
    for number, stamp in enumerate(stamps):
        if stamp > newest:
            times[number] = newest = stamp
    if len(times) < len(stamps):
        notes.append(
            f"{len(stamps) - len(times)} images of {topic} are not later than those before them, "
            "left out"
        )
    return times


def _paired(left: Mapping[int, int], right: Mapping[int, int]) -> list[list[int]]:
    """Return the numbers of left and of right images that make pairs."""
    pairs: list[list[int]] = [[], []]
    others = deque(right.items())
    for number, stamp in left.items():
        while others and others[0][1] < stamp - _PAIR_TOLERANCE:
            others.popleft()
        if others and others[0][1] <= stamp + _PAIR_TOLERANCE:
            pairs[0].append(number)
            pairs[1].append(others.popleft()[0])
    return pairs


def _gray(name: str, number: int, message: Any) -> Gray:
    try:
        if hasattr(message, "format"):
            return decode(f"it ({message.format})", np.asarray(message.data, np.uint8).tobytes())
        return gray_of(
            Image(
                height=message.height,
                width=message.width,
                encoding=message.encoding,
                is_bigendian=message.is_bigendian,
                step=message.step,
                data=np.asarray(message.data, np.uint8).ravel(),
            )
        )
    except (CairnError, InvalidMessage) as error:
        raise RecordingError(f"{name}, image {number + 1}: {error}") from error


def _camera_of_topic(topic: str) -> str | None:
    """Return the camera that a part of a topic's name indicates."""
    sides = {camera_of(Path(part)) for part in topic.strip("/").split("/")} - {None}
    return sides.pop() if len(sides) == 1 else None


# Stamps that are further from the time of receipt than this are of another clock [ns].
_CLOCK_TOLERANCE = 60 * SECOND


def message_stamps(topic: str, received: Sequence[tuple[int, Any]]) -> tuple[list[int], str]:
    """Return the stamps [ns] of a topic's messages, and a note, or "".

    If the stamps are of another clock, they are replaced by the times of receipt, with a note.

    `received` are the times of receipt [ns] and the stamps (builtin_interfaces/Time).
    """
    if not received:
        return [], ""
    stamps = [stamp.sec * SECOND + stamp.nanosec for _, stamp in received]
    apart = sorted(
        abs(stamp - receipt) for (receipt, _), stamp in zip(received, stamps, strict=True)
    )
    if apart[len(apart) // 2] <= _CLOCK_TOLERANCE:
        return stamps, ""
    return [receipt for receipt, _ in received], (
        f"stamps on {topic} are from another clock than the bag's (the first is "
        f"{stamps[0] / SECOND:g} s): the times of receipt are used instead"
    )
