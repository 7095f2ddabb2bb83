"""Between the localizer's types and the messages on the bus."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from components.localizer.judge import Judgement
from components.localizer.localization import Frame
from components.localizer.object_likelihood import Landmark, Sighting
from components.localizer.particles import Estimate
from schemas.cairn_msgs import (
    ObjectEvidence,
    ObjectEvidenceArray,
    RecognizedObjectArray,
    VisualMap,
    VisualObject,
)
from schemas.geometry_msgs import (
    Point,
    Pose,
    PoseArray,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from schemas.packed import Packed
from schemas.std_msgs import Header
from schemas.tf2_msgs import TFMessage

Array = NDArray[np.float64]
Pose2 = tuple[float, float, float]

# Where x, y and yaw stand in a message's row-major 6 x 6 covariance.
_PLANAR = np.array([0, 1, 5])
# A sighting whose sender states no covariance is taken to be this good [m, rad].
_RANGE_SD, _BEARING_SD = 0.2, math.radians(3.0)


def landmarks_of(visual_map: VisualMap) -> list[Landmark]:
    """The objects of the map as landmarks."""
    return [
        Landmark(
            object_id=o.object_id,
            x=o.x,
            y=o.y,
            xx=float(o.covariance[0]),
            xy=float(o.covariance[1]),
            yy=float(o.covariance[3]),
            reliability=min(0.98, max(0.02, o.reliability)),
            live=o.state == VisualObject.LIVE,
        )
        for o in visual_map.objects
    ]


def sightings_of(message: RecognizedObjectArray) -> list[Sighting]:
    """The recognised objects as sightings."""
    return [
        Sighting(
            object_id=o.object_id,
            range_m=o.range,
            bearing=o.bearing,
            range_variance=float(o.covariance[0]) or _RANGE_SD**2,
            bearing_variance=float(o.covariance[3]) or _BEARING_SD**2,
        )
        for o in message.objects
    ]


def yaw_of(pose: Pose) -> float:
    """The heading [rad] of a pose."""
    q = pose.orientation
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def planar(pose: PoseWithCovariance) -> tuple[Pose2, Array]:
    """x [m], y [m], heading [rad] and their covariance (3, 3)."""
    where = pose.pose.position
    covariance = pose.covariance.reshape(6, 6)[np.ix_(_PLANAR, _PLANAR)]
    return (where.x, where.y, yaw_of(pose.pose)), covariance


def pose_message(header: Header, pose: Pose2, covariance: Array) -> PoseWithCovarianceStamped:
    """A planar pose and its covariance (3, 3) as a message."""
    full = np.zeros((6, 6))
    full[np.ix_(_PLANAR, _PLANAR)] = 0.5 * (covariance + covariance.T)
    x, y, theta = pose
    return PoseWithCovarianceStamped(
        header=header,
        pose=PoseWithCovariance(
            pose=Pose(
                position=Point(x=x, y=y),
                orientation=Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2)),
            ),
            covariance=full.ravel(),
        ),
    )


def cloud_message(header: Header, poses: Array) -> PoseArray:
    """Poses (3, n) as a message."""
    rows = np.zeros((poses.shape[1], 7))
    rows[:, 0], rows[:, 1] = poses[0], poses[1]
    rows[:, 5], rows[:, 6] = np.sin(poses[2] / 2), np.cos(poses[2] / 2)
    return PoseArray(header=header, poses=Packed(Pose, rows))


def transform_message(header: Header, pose: Pose2, in_odometry: Pose2) -> TFMessage:
    """The transform map -> odom that puts the odometry frame's pose where the robot is."""
    theta = pose[2] - in_odometry[2]
    cosine, sine = math.cos(theta), math.sin(theta)
    x = pose[0] - cosine * in_odometry[0] + sine * in_odometry[1]
    y = pose[1] - sine * in_odometry[0] - cosine * in_odometry[1]
    transform = Transform(
        translation=Vector3(x=x, y=y),
        rotation=Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2)),
    )
    return TFMessage(
        transforms=(TransformStamped(header=header, child_frame_id="odom", transform=transform),)
    )


def evidence_message(header: Header, frame: Frame) -> ObjectEvidenceArray:
    """The judgements of one frame and the pose that they were made from."""
    before: Estimate = frame.before
    x, y, theta = before.mean
    covariance = 0.5 * (before.covariance + before.covariance.T)
    return ObjectEvidenceArray(
        header=header,
        robot_x=x,
        robot_y=y,
        robot_theta=theta,
        robot_covariance=covariance.ravel(),
        healthy=frame.healthy,
        reason=frame.reason,
        evidence=tuple(map(_evidence, frame.judgements)),
    )


def _evidence(judgement: Judgement) -> ObjectEvidence:
    covariance = 0.5 * (judgement.covariance + judgement.covariance.T)
    return ObjectEvidence(
        object_id=judgement.sighting.object_id,
        similarity=judgement.similarity,
        verdict=int(judgement.verdict),
        distance=judgement.distance,
        x=judgement.x,
        y=judgement.y,
        covariance=covariance.ravel(),
        range=judgement.sighting.range_m,
        bearing=judgement.sighting.bearing,
    )
