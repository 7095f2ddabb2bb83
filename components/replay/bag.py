"""One ROS bag as the drivers see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cairn import SECOND, from_ns
from cairn.components.replay.bag_file import read_bag
from cairn.components.replay.bag_images import bag_images, image_topics
from cairn.components.replay.bag_times import own_stamps
from cairn.components.replay.recording import (
    Images,
    Odometry,
    RecordingError,
    Scans,
    Sightings,
    Source,
    Trajectory,
    from_deviations,
)
from cairn.components.replay.wheel_odometry import deviations, velocities
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.geometry_msgs import Point, Quaternion
from cairn.schemas.geometry_msgs import Pose as PoseMessage
from cairn.schemas.message import InvalidMessage
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

T = TypeVar("T")
Received = Sequence[tuple[int, Any]]
"""Messages with their times of receipt [ns]."""

_SCAN = "sensor_msgs/msg/LaserScan"
_ODOMETRY = "nav_msgs/msg/Odometry"
_TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TRUE = {
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
    _ODOMETRY: lambda message: message.pose.pose,
}
_BASES = ("base_footprint", "base_link")


class BagRecording:
    """The bag at `path`; `topics` names its topics for `scan`, `odom`, `truth` where need be.

    Scans get a time `scan_delay_s` [s] before the one that they bear.
    """

    def __init__(self, path: Path, topics: Mapping[str, str], scan_delay_s: float = 0.0) -> None:
        """Read it all; raises `RecordingError`."""
        self._path = path
        self._named = {kind: "/" + name.lstrip("/") for kind, name in topics.items()}
        bag = read_bag(path, self._choose)
        self._types = {"/" + topic.lstrip("/"): kind for topic, kind in bag.types.items()}
        self._messages = {"/" + topic.lstrip("/"): of for topic, of in bag.messages.items()}
        self._counts = {"/" + topic.lstrip("/"): count for topic, count in bag.counts.items()}
        self._notes = bag.notes
        self._scan_delay = round(scan_delay_s * SECOND)
        scan, odom = self._topic("scan", (_SCAN,)), self._topic("odom", (_ODOMETRY,))
        truth = self._topic("truth", tuple(_TRUE)) if "truth" in self._named else None
        self._scans = self._read(scan, self._to_scans)
        self._odometry = self._read(odom, self._to_odometry)
        self._replayed = {topic: kind for topic, kind in ((scan, "scan"), (odom, "odom")) if topic}
        if self._odometry is None:
            transforms = {t: of for t, of in self._messages.items() if self._types[t] in _TF}
            self._odometry = self._from_tf([pair for of in transforms.values() for pair in of])
            if self._odometry is not None:
                self._replayed |= dict.fromkeys(transforms, "odom")
        self._truth = self._read(truth, self._to_trajectory)
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
        """Times [ns] of the first and the last scan or odometry, else image."""
        both = [x.stamps for x in (self._scans, self._odometry) if x is not None]
        images = None if both else self.images()
        if images is not None:
            return images.stamps[0], images.stamps[-1]
        return min(stamps[0] for stamps in both), max(stamps[-1] for stamps in both)

    def odometry(self) -> Odometry | None:
        """Odometry messages, else the transforms from frame odom to the robot's base."""
        return self._odometry

    def scans(self) -> Scans | None:
        """The laser's scans."""
        return self._scans

    def sightings(self) -> Sightings | None:
        """None: no message of ROS's own tells of landmarks."""
        return None

    def images(self) -> Images | None:
        """The images of a camera's topic, or of a stereo camera's two."""
        if not self._image_topics:
            return None
        images, notes = bag_images(self._path, self._image_topics)
        self._notes += [note for note in notes if note not in self._notes]
        return images

    def truth(self) -> Trajectory | None:
        """The poses of the topic that `topics` names for them."""
        return self._truth

    def surveyed(self) -> VisualMap | None:
        """None: no message of ROS's own tells of landmarks."""
        return None

    def sources(self) -> Sequence[Source]:
        """The bag's topics."""
        return [
            Source(self._replayed.get(topic), topic, kind, self._counts.get(topic, 0))
            for topic, kind in sorted(self._types.items())
        ]

    def notes(self) -> Sequence[str]:
        """What was lost or assumed."""
        return self._notes

    def _choose(self, types: Mapping[str, str]) -> list[str]:
        kinds = (_SCAN, _ODOMETRY, *_TF, *_TRUE)
        named = set(self._named.values())
        return [t for t, kind in types.items() if kind in kinds or "/" + t.lstrip("/") in named]

    def _topic(self, kind: str, types: Sequence[str]) -> str | None:
        """The topic to take, None if the bag has none of that kind."""
        found = sorted(topic for topic, of in self._types.items() if of in types)
        named = self._named.get(kind)
        if named is not None:
            if named in found:
                return named
            if kind == "odom" and self._types.get(named) in _TF:
                return None
            raise RecordingError(
                f"{self._path}: topics.{kind} = {named} is no topic of {' or '.join(types)}; "
                f"there {'are ' + ', '.join(found) if found else 'is none'}."
            )
        if len(found) > 1 and f"/{kind}" not in found:
            raise RecordingError(
                f"{self._path} has several topics of {types[0]}: {', '.join(found)}. Name one "
                f"with the parameter topics.{kind} (`cairn recording show`: --{kind})."
            )
        return f"/{kind}" if f"/{kind}" in found else next(iter(found), None)

    def _read(self, topic: str | None, convert: Callable[[list[int], list[Any]], T]) -> T | None:
        """The messages of a topic in order of their stamps, converted; None if there are none."""
        received = self._messages.get(topic, []) if topic else []
        if not received:
            return None
        stamps = self._stamps(topic or "", [(at, m.header.stamp) for at, m in received])
        order = sorted(range(len(stamps)), key=stamps.__getitem__)
        try:
            return convert([stamps[k] for k in order], [received[k][1] for k in order])
        except (InvalidMessage, ValueError) as error:
            raise RecordingError(
                f"{self._path}, topic {topic}: {error}. Such a message is not replayed: name "
                "another topic, or take it out of the bag."
            ) from error

    def _stamps(self, topic: str, received: Sequence[tuple[int, Any]]) -> list[int]:
        stamps, note = own_stamps(topic, received)
        self._notes += [note] if note else []
        return stamps

    def _to_scans(self, stamps: list[int], messages: list[Any]) -> Scans:
        stamps = [max(stamp - self._scan_delay, 0) for stamp in stamps]
        scans = []
        for number, (stamp, m) in enumerate(zip(stamps, messages, strict=True), start=1):
            try:
                scans.append(_scan(stamp, m))
            except InvalidMessage as error:
                raise ValueError(f"message {number}: {error}") from error
        return Scans(stamps, scans)

    @staticmethod
    def _to_odometry(stamps: list[int], messages: list[Any]) -> Odometry:
        poses = np.array([_planar(m.pose.pose) for m in messages])
        told = np.array([m.pose.covariance for m in messages], dtype=np.float64)
        covariances = told.reshape(-1, 6, 6)[:, [0, 1, 5]][:, :, [0, 1, 5]]
        if not covariances.any() or not np.isfinite(covariances).all():
            covariances = from_deviations(deviations(poses))
        twists = np.array([(m.twist.twist.linear.x, m.twist.twist.angular.z) for m in messages])
        return Odometry(stamps, poses, covariances, twists)

    @staticmethod
    def _to_trajectory(stamps: list[int], messages: list[Any]) -> Trajectory:
        poses = [_planar(_TRUE[m.__msgtype__](m)) for m in messages]
        return Trajectory(stamps, np.array(poses))

    def _from_tf(self, received: Received) -> Odometry | None:
        """Odometry from transforms of frame odom to the base."""
        pairs = [
            (at, transform)
            for at, message in received
            for transform in message.transforms
            if transform.header.frame_id.strip("/") == "odom"
            and transform.child_frame_id.strip("/") in _BASES
        ]
        if not pairs:
            return None
        stamps = self._stamps("/tf", [(at, t.header.stamp) for at, t in pairs])
        order = sorted(range(len(stamps)), key=stamps.__getitem__)
        stamps = [stamps[k] for k in order]
        poses = np.array([_placed(pairs[k][1].transform) for k in order])
        self._notes.append("odometry is taken from the transforms of frame odom")
        covariances = from_deviations(deviations(poses))
        return Odometry(stamps, poses, covariances, velocities(stamps, poses))


def _scan(stamp: int, m: Any) -> LaserScan:
    beams = len(m.ranges)
    return LaserScan(
        header=Header(stamp=from_ns(stamp), frame_id="laser"),
        angle_min=float(m.angle_min),
        angle_max=float(m.angle_max),
        angle_increment=float(m.angle_increment),
        time_increment=float(m.time_increment),
        scan_time=float(m.scan_time),
        range_min=float(m.range_min),
        range_max=float(m.range_max),
        ranges=np.asarray(m.ranges, dtype=np.float32),
        # Some drivers send a number of intensities of their own; they are then no one's.
        intensities=np.asarray(m.intensities if len(m.intensities) == beams else [], np.float32),
    )


def _planar(pose: Any) -> Pose:
    return _placed_at(pose.position, pose.orientation)


def _placed(transform: Any) -> Pose:
    return _placed_at(transform.translation, transform.rotation)


def _placed_at(place: Any, turn: Any) -> Pose:
    message = PoseMessage(
        position=Point(x=float(place.x), y=float(place.y)),
        orientation=Quaternion(x=float(turn.x), y=float(turn.y), z=float(turn.z), w=float(turn.w)),
    )
    return planar_pose(message)
