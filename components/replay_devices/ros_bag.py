"""Recordings that are ROS 1 bags, ROS 2 bags or MCAP files: the streams that they hold.

Images are read from the file as they are replayed: all at once would fill the memory.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.replay_devices.bag_images import bag_images, first_calibration, image_topics
from cairn.components.replay_devices.bag_messages import (
    ECHOES_TYPE,
    INFO_TYPE,
    MAP_TYPE,
    OBJECTS_TYPE,
    ODOMETRY_TYPE,
    POSE_TYPES,
    SCAN_TYPE,
    TEXT_TYPE,
    TRANSFORM_TYPES,
    NothingMeasured,
    clock_offset,
    is_same_clock,
    message_stamps,
    read_bag,
    scan_of,
    usual_topic,
)
from cairn.components.replay_devices.record_times import (
    TimeQuality,
    time_quality,
    times_apart,
)
from cairn.components.replay_devices.recording import (
    BAD_SHARE,
    FEW_BAD,
    ImageStream,
    ObservationStream,
    OdometryStream,
    RecordedTopic,
    Recording,
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
from cairn.components.replay_devices.wheel_odometry import (
    odometry_deviations,
    odometry_velocities,
    velocities_agree,
)
from cairn.errors import RecordingError
from cairn.planar.messages import has_orientation, planar_pose
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import RecognizedObjectArray, VisualMap
from cairn.schemas.geometry_msgs import Point, Quaternion
from cairn.schemas.geometry_msgs import Pose as PoseMessage
from cairn.schemas.message import InvalidMessage, repairs_of
from cairn.schemas.sensor_msgs import CameraInfo, LaserScan

Array = NDArray[np.float64]
Item = TypeVar("Item")
T = TypeVar("T")
Received = Sequence[tuple[int, Any]]
"""Messages with their times of receipt [ns]."""


class BagRecording(Recording):
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
        scan = self._topic("scan", (SCAN_TYPE, ECHOES_TYPE))
        odom = self._topic("odom", (ODOMETRY_TYPE,))
        truth = self._topic("truth", tuple(POSE_TYPES)) if "truth" in self._named else None
        truth = truth or self._usual("truth", tuple(POSE_TYPES))
        objects = self._usual("recognized_objects", (OBJECTS_TYPE,))
        surveyed = self._usual("true_map", (MAP_TYPE,))
        self._quality: dict[str, TimeQuality] = {}
        self._clock_offset = self._common_offset([one for one in (scan, odom) if one])
        self._mount = self._find_mount(scan, odom)
        self._scans = self._read("scan", scan, self._to_scan, self._to_scans)
        self._odometry = self._read("odom", odom, _odometry_step, self._to_odometry)
        self._objects = self._read("objects", objects, lambda _, message: message, _observations)
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
            if notes:
                raise RecordingError(f"{path} holds only images, and {notes[0]}.")
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
        images, notes = bag_images(self._path, self._image_topics, self._clock_offset)
        self._notes += [note for note in notes if note not in self._notes]
        infos = [self._calibration(topic) for topic in self._image_topics]
        return replace(images, infos=tuple(infos))

    def _calibration(self, image_topic: str) -> CameraInfo | None:
        """Return the first calibration of a camera: `left_info` of `left_image`, or ROS's name."""
        namespace, _, name = image_topic.rpartition("/")
        for topic in (f"{namespace}/{name.replace('image', 'info')}", f"{namespace}/camera_info"):
            if self._types.get(topic) == INFO_TYPE:
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

    def _common_offset(self, topics: Sequence[str]) -> int:
        """Return by how much the times of receipt are ahead of a clock that all stamps have [ns].

        It is 0 if the stamps are of the recorder's clock, or not of one clock. In a recording of a
        simulation they are of the simulation's, which is as fast as the robot moves.
        """
        received = [self._messages.get(topic, []) for topic in topics]
        offsets = [clock_offset([(at, m.header.stamp) for at, m in of]) for of in received if of]
        if len(offsets) < 2 or is_same_clock(offsets[0], 0):
            return 0
        if not is_same_clock(*offsets):
            return 0
        self._notes.append(
            "the stamps of scans and odometry are from one clock, another one than the bag's: kept"
        )
        return offsets[0]

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
        described = [topic for topic in self._messages if self._types[topic] == TEXT_TYPE]
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
        return self._gathered(kind, topic or "", received, parse, gather)

    def _gathered(
        self,
        kind: str,
        topic: str,
        received: Received,
        parse: Callable[[int, Any], Item],
        gather: Callable[[list[int], list[Item]], T],
    ) -> T | None:
        """Gather messages as `_read` does, of which `topic` is only named in notes and errors."""
        if not received:
            return None
        stamps = self._stamps(topic, [(at, m.header.stamp) for at, m in received])
        apart = times_apart(dict(enumerate(stamps)))
        if len(apart) > max(FEW_BAD, BAD_SHARE * len(stamps)):
            apart = {}  # a pause, or another run
        self._quality[kind] = time_quality([s for k, s in enumerate(stamps) if k not in apart])
        parsed: list[Item] = []
        known: list[int] = []
        faults: list[str] = []
        empty: list[str] = []
        for k in sorted(range(len(stamps)), key=stamps.__getitem__):
            if k in apart:
                empty.append(apart[k])
                continue
            try:
                parsed.append(parse(stamps[k], received[k][1]))
                known.append(stamps[k])
            except NothingMeasured as error:
                empty.append(str(error))
            except (InvalidMessage, ValueError) as error:
                faults.append(f"message {k + 1}: {error}")
        if len(faults) > max(FEW_BAD, BAD_SHARE * len(stamps)) or not parsed:
            wrong = faults or empty
            raise RecordingError(
                f"{self._path}, topic {topic}: {wrong[0]}. {len(wrong)} of {len(stamps)} "
                "messages are invalid, which cannot be replayed: name another topic, or remove "
                "them from the bag."
            )
        if faults:
            self._notes.append(
                f"{len(faults)} of {len(stamps)} messages of {topic} are invalid and left out: "
                f"{faults[0]}{'; ...' if len(faults) > 1 else ''}"
            )
        if empty:
            self._notes.append(
                f"{len(empty)} of {len(stamps)} messages of {topic} are left out: {empty[0]}"
            )
        return gather(known, parsed)

    def _stamps(self, topic: str, received: Sequence[tuple[int, Any]]) -> list[int]:
        stamps, note = message_stamps(topic, received, self._clock_offset)
        self._notes += [note] if note else []
        return stamps

    def _to_scan(self, stamp: int, message: Any) -> LaserScan:
        upside_down = self._mount is not None and self._mount.upside_down
        return scan_of(self._undelayed(stamp), message, upside_down)

    def _to_scans(self, stamps: list[int], scans: list[LaserScan]) -> ScanStream:
        repairs = Counter(text for scan in scans for text in repairs_of(scan))
        self._notes += [
            f"{count} of {len(scans)} scans are repaired: {text}" for text, count in repairs.items()
        ]
        return ScanStream([self._undelayed(stamp) for stamp in stamps], scans, stamps)

    def _to_odometry(self, stamps: list[int], steps: list[_OdometryStep]) -> OdometryStream:
        computed = _computed_odometry(stamps, [step.pose for step in steps])
        covariances = np.array([step.covariance for step in steps])
        twists = np.array([step.twist for step in steps])
        if not velocities_agree(stamps, computed.poses, twists):
            self._notes.append(
                "velocities are computed from the poses: the recorded ones are missing or disagree"
            )
            twists = computed.twists
        if not _is_known(covariances):
            covariances = computed.covariances
        return OdometryStream(stamps, computed.poses, covariances, twists)

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
        if pairs:
            self._notes.append("odometry is computed from the transforms of frame odom")
        return self._gathered("odom", "/tf", pairs, _transformed_pose, _computed_odometry)


@dataclass(frozen=True)
class _OdometryStep:
    """A message of odometry: pose, covariance (3, 3) as it is, forward and turning velocity."""

    pose: Pose
    covariance: Array
    twist: tuple[float, float]


def _transformed_pose(_: int, message: Any) -> Pose:
    moved = message.transform
    return _oriented_pose(moved.translation, moved.rotation)


def _oriented_pose(position: Any, rotation: Any) -> Pose:
    if not has_orientation(rotation):
        raise ValueError("its orientation is not set: all four numbers are 0")
    return _pose_of(position, rotation)


def _computed_odometry(stamps: list[int], poses: list[Pose]) -> OdometryStream:
    """Return odometry of which only the poses are known."""
    rows = np.array(poses)
    covariances = covariances_of(odometry_deviations(rows))
    return OdometryStream(stamps, rows, covariances, odometry_velocities(stamps, rows))


def _odometry_step(_: int, message: Any) -> _OdometryStep:
    covariance = np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)
    twist = (float(message.twist.twist.linear.x), float(message.twist.twist.angular.z))
    if not all(map(math.isfinite, twist)):
        raise ValueError(f"its velocity is {twist[0]:g} m/s, {twist[1]:g} rad/s")
    pose = _oriented_pose(message.pose.pose.position, message.pose.pose.orientation)
    return _OdometryStep(pose, covariance[[0, 1, 5]][:, [0, 1, 5]], twist)


def _is_known(covariances: Array) -> bool:
    """Return whether odometry states its covariances (n, 3, 3): drivers write 0, NaN or -1 else."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    return bool(covariances.any() and np.isfinite(covariances).all() and (variances >= 0.0).all())


def _observations(stamps: list[int], messages: list[RecognizedObjectArray]) -> ObservationStream:
    return ObservationStream(stamps, (), messages)


def _true_pose(_: int, message: Any) -> Pose:
    return _pose(POSE_TYPES[message.__msgtype__](message))


def _timed_poses(stamps: list[int], poses: list[Pose]) -> TimedPoses:
    return TimedPoses(stamps, np.array(poses))


def _pose(pose: Any) -> Pose:
    return _pose_of(pose.position, pose.orientation)


def _pose_of(position: Any, rotation: Any) -> Pose:
    message = PoseMessage(
        position=Point(x=float(position.x), y=float(position.y)),
        orientation=Quaternion(
            x=float(rotation.x), y=float(rotation.y), z=float(rotation.z), w=float(rotation.w)
        ),
    )
    return planar_pose(message)
