"""Odometry of the base: whether it is usable, continuity across jumps, conversion to messages."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND, from_ns
from cairn.components.ros2_devices.config import Ros2BaseConfig
from cairn.planar.messages import has_orientation, pose_message, transform_message
from cairn.planar.odometry import (
    ODOMETRY_DISORDER_S,
    OUTDATED_IN_A_ROW,
    OdometryChange,
    OdometryHistory,
    WheelLimits,
)
from cairn.planar.poses import Pose, apart, compose, inverse
from cairn.schemas.geometry_msgs import PoseWithCovariance, TransformStamped
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]

_ODOM, _BASE = "odom", "base_link"  # frames of Cairn's robots
_NORM_TOLERANCE = 0.05  # how far the norm of an orientation may differ from 1
_FASTER = 2.0  # times the commanded speed: the base may slow down late, or be pushed
_SLACK_M = 0.1
_SLACK_RAD = 0.2
_SLACK_S = 0.1  # a motion that takes this much longer than the time passed is still possible
_ORIGIN: Pose = (0.0, 0.0, 0.0)


def rejection(message: Odometry, config: Ros2BaseConfig) -> str | None:
    """Return why a message of odometry cannot be used, as a sentence; None if it can."""
    frames = (message.header.frame_id, message.child_frame_id)
    expected = (config.odom_frame, config.base_frame)
    if any(
        name.strip("/") not in ("", frame.strip("/"))
        for name, frame in zip(frames, expected, strict=True)
    ):
        return (
            f"the base's odometry is of frame {frames[1]!r} in {frames[0]!r}, not of "
            f"{config.base_frame!r} in {config.odom_frame!r}; set base_frame and odom_frame"
        )
    if not has_orientation(message.pose.pose.orientation):
        return (
            "the orientation in the base's odometry is not set (x, y, z, w are 0), without which "
            "the robot's heading is not known; correct the node that publishes it"
        )
    return None


def understood(message: Odometry, config: Ros2BaseConfig) -> list[str]:
    """Return how a message of odometry that is used is understood where it does not say it."""
    q = message.pose.pose.orientation
    norm = math.hypot(q.x, q.y, q.z, q.w)
    found = []
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        found.append("their orientations are not of length 1, and are divided by it")
    if not _states_variances(message):
        found.append("they state no variances (below 0), which are taken as 0, not known")
    if not message.header.frame_id:
        found.append(f"they name no frame, and are taken as in {config.odom_frame}")
    if not message.child_frame_id:
        found.append(f"they name no child frame, and are taken as of {config.base_frame}")
    return found


@dataclass(frozen=True)
class ContinuedPose:
    """A pose of the base in frame `odom`, which has no jumps.

    `rotation`: how far the pose is rotated against the base's own one [rad].
    """

    pose: Pose
    rotation: float


class OdometryContinuity:
    """Continues the base's poses where they jump, as when the base was restarted.

    Frame `odom` is continuous by definition (REP 105), and localization relies on it. After a long
    silence nearly any motion is possible; but a base that is at its origin then was restarted. A
    pose that arrives late is continued as those of its time, and does not count as a jump.
    """

    def __init__(self, config: Ros2BaseConfig) -> None:
        self._fastest = WheelLimits(_FASTER * config.speed, _FASTER * config.turn)
        self._silence_s = config.odom_timeout_s
        self._history = OdometryHistory[int](
            round(ODOMETRY_DISORDER_S * SECOND),
            self._fastest,
            resets_after=OUTDATED_IN_A_ROW,
        )
        self._offset = self._offset_before = _ORIGIN
        self._jumped_ns: int | None = None
        self._last: tuple[int, Pose] | None = None
        self.jumps = 0

    @property
    def newest(self) -> int | None:
        """Time of the newest pose [ns]; None before the first, and after time was set back."""
        return self._history.newest

    def has(self, stamp: int) -> bool:
        """Return whether a recent pose has this time [ns]."""
        return self._history.has(stamp)

    def set_time_back(self) -> None:
        """Let the next pose be the newest one."""
        self._history.clear()
        self._jumped_ns = None

    def add(self, stamp: int, reported: Pose) -> ContinuedPose | None:
        """Return the continued pose for the one that the base reports at a time [ns].

        None if it is too late, or contradicts the poses before and after it.
        """
        newest = self._history.newest
        if newest is not None and stamp < newest:
            is_before_jump = self._jumped_ns is not None and stamp < self._jumped_ns
            late = _continued(self._offset_before if is_before_jump else self._offset, reported)
            change = self._history.add(stamp, late.pose)
            if change is OdometryChange.LATE:
                return late
            if change is OdometryChange.OUTDATED:
                return None
            self.set_time_back()
        if self._last is not None and self._jumped(
            (stamp - self._last[0]) / SECOND, self._last[1], reported
        ):
            self.jumps += 1
            self._jumped_ns, self._offset_before = stamp, self._offset
            before = compose(self._offset, self._last[1])
            self._offset = compose(before, inverse(reported))
        self._last = (stamp, reported)
        continued = _continued(self._offset, reported)
        self._history.add(stamp, continued.pose)
        return continued

    def _jumped(self, seconds: float, before: Pose, after: Pose) -> bool:
        fastest, possible_s = self._fastest, max(0.0, seconds) + _SLACK_S
        too_far = apart(
            before,
            after,
            fastest.speed * possible_s + _SLACK_M,
            fastest.turn * possible_s + _SLACK_RAD,
        )
        return too_far or (
            seconds > self._silence_s and _at_origin(after) and not _at_origin(before)
        )


def odometry_message(message: Odometry, stamp: int, continued: ContinuedPose) -> Odometry:
    """Return the base's odometry in the robot's frames, and in the plane."""
    covariance = np.zeros(36)
    if _states_variances(message):
        covariance = rotate_covariance(message.pose.covariance, continued.rotation)
    return dataclasses.replace(
        message,
        header=Header(stamp=from_ns(stamp), frame_id=_ODOM),
        child_frame_id=_BASE,
        pose=PoseWithCovariance(pose=pose_message(continued.pose), covariance=covariance),
    )


def _states_variances(message: Odometry) -> bool:
    """Return whether the variances in the plane are known; some drivers write -1 otherwise."""
    return bool((message.pose.covariance[[0, 7, 35]] >= 0.0).all())


def odometry_transform(message: Odometry, pose: Pose) -> TransformStamped:
    """Return the same pose as a transform."""
    return transform_message(message.header, _BASE, pose)


def rotate_covariance(covariance: Array, angle: float) -> Array:
    """Rotate a row-major 6 x 6 covariance of a pose by an angle [rad] about z."""
    if not angle:
        return covariance
    cosine, sine = np.cos(angle), np.sin(angle)
    about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    rotation = np.kron(np.eye(2), about_z)
    rotated: Array = (rotation @ covariance.reshape(6, 6) @ rotation.T).ravel()
    return rotated


def _continued(offset: Pose, reported: Pose) -> ContinuedPose:
    return ContinuedPose(compose(offset, reported), offset[2])


def _at_origin(pose: Pose) -> bool:
    return not apart(_ORIGIN, pose, _SLACK_M, _SLACK_RAD)
