"""Conversions between the types of the localizer and messages."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cairn import SECOND, from_ns
from cairn.components.localizer.hypotheses import Alternative
from cairn.components.localizer.localization import EvidenceFrame
from cairn.components.localizer.observations import CameraView, Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.pose_health import PoseHealth
from cairn.planar.messages import planar_covariance, with_covariance
from cairn.planar.poses import Pose, compose, inverse
from cairn.schemas.cairn_msgs import (
    ObjectEvidenceArray,
    RecognizedObjectArray,
    VisualMap,
    VisualObject,
)
from cairn.schemas.cairn_nav_msgs import (
    AlternativePose,
    LocalizationEstimate,
    Relocalization,
)
from cairn.schemas.geometry_msgs import (
    PoseWithCovariance,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

# The limits of the reliability, as the map builder keeps them (`map_builder/pose_reliability.py`).
_LEAST_RELIABILITY, _MOST_RELIABILITY = 0.02, 0.98
# Less probable positions are not published.
_LEAST_PROBABILITY = 0.001


def landmarks_of(visual_map: VisualMap) -> list[Landmark]:
    """Return the objects of the map as landmarks."""
    return [
        Landmark(
            object_id=o.object_id,
            x=o.x,
            y=o.y,
            xx=float(o.covariance[0]),
            xy=float(o.covariance[1]),
            yy=float(o.covariance[3]),
            reliability=min(_MOST_RELIABILITY, max(_LEAST_RELIABILITY, o.reliability)),
            live=o.state == VisualObject.LIVE,
        )
        for o in visual_map.objects
    ]


def view_of(message: RecognizedObjectArray) -> CameraView | None:
    """Return where an object could have been recognized; None if that is not known."""
    if message.view_left <= message.view_right:
        return None
    return CameraView(message.view_right, message.view_left, message.nearest, message.farthest)


def transform_message(header: Header, pose: Pose, in_odometry: Pose) -> TFMessage:
    """Return the transform map -> odom: `in_odometry` becomes `pose`."""
    x, y, theta = compose(pose, inverse(in_odometry))
    transform = Transform(
        translation=Vector3(x=x, y=y),
        rotation=Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2)),
    )
    return TFMessage(
        transforms=(TransformStamped(header=header, child_frame_id="odom", transform=transform),)
    )


def estimate_message(
    header: Header,
    pose: PoseWithCovariance | None,
    health: PoseHealth,
    particles: int,
    alternatives: Sequence[Alternative],
) -> LocalizationEstimate:
    """Return the message of a pose with its health; `pose` is None if the robot is not located."""
    covariance = planar_covariance(pose) if pose else np.zeros((3, 3))
    return LocalizationEstimate(
        header=header,
        located=pose is not None,
        pose=pose or PoseWithCovariance(),
        health=health.value,
        position_sd=math.sqrt(max(0.0, float(covariance[0, 0] + covariance[1, 1]))),
        heading_sd=math.sqrt(max(0.0, float(covariance[2, 2]))),
        scan_fit=math.nan if health.fit is None else health.fit,
        objects_agreeing=health.support.agreeing,
        objects_contradicting=health.support.contradicting,
        particles=particles if pose else 0,
        alternatives=tuple(
            AlternativePose(*one.pose, probability=one.probability)
            for one in alternatives
            if one.probability >= _LEAST_PROBABILITY
        ),
        reason=health.reason.text,
        reason_code=int(health.reason.code),
    )


def relocalization_message(
    header: Header, found: PoseEstimate, confirmed_until: float
) -> Relocalization:
    """Return where a lost robot was found, and until when [s] it was not lost, -inf if unknown."""
    return Relocalization(
        header=header,
        pose=with_covariance(found.mean, found.covariance),
        confirmed_until=from_ns(round(max(0.0, confirmed_until) * SECOND)),
    )


def evidence_message(header: Header, frame: EvidenceFrame) -> ObjectEvidenceArray:
    """Return the evidence of one image, and the pose that it was compared with."""
    before: PoseEstimate = frame.before
    x, y, theta = before.mean
    covariance = 0.5 * (before.covariance + before.covariance.T)
    return ObjectEvidenceArray(
        header=header,
        robot_x=x,
        robot_y=y,
        robot_theta=theta,
        robot_covariance=covariance.ravel(),
        healthy=frame.healthy,
        reason=frame.reason.text,
        reason_code=int(frame.reason.code),
        evidence=frame.evidence,
    )
