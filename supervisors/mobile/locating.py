"""Tells a localizer from a terminal where the robot is."""

from __future__ import annotations

import secrets
import time

import zenoh

from cairn import CairnError
from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.cli.connection import Connection, resolve
from cairn.planar.messages import pose_message
from cairn.planar.poses import Pose
from cairn.schemas.geometry_msgs import PoseWithCovariance, PoseWithCovarianceStamped
from cairn.schemas.message import type_name
from cairn.schemas.std_msgs import Header

_TOPIC = "initialpose"
_TYPE = type_name(PoseWithCovarianceStamped)


def point_out(connection: Connection, robot: str, pose: Pose) -> str:
    """Publish a pose in frame map for the localizer; the topic. `CairnError` if nobody reads it."""
    topics = {
        end.topic
        for end in connection.endpoints()
        if end.kind == "MS" and end.type_name == _TYPE and end.topic.endswith(f"/{_TOPIC}")
    }
    if not topics:
        raise CairnError(
            f"nobody reads {_TOPIC} here: the localizer is loaded with the first order to move; "
            "until then its parameter `start` says where the robot is"
        )
    topic = resolve(sorted(topics), _TOPIC, robot)
    codec = Codec()
    connection.session.put(
        keys.message_key(connection.domain, topic, PoseWithCovarianceStamped, codec),
        codec.encode(
            PoseWithCovarianceStamped(
                header=Header(frame_id="map"), pose=PoseWithCovariance(pose=pose_message(pose))
            )
        ),
        encoding=zenoh.Encoding.APPLICATION_CDR.with_schema(_TYPE),
        congestion_control=zenoh.CongestionControl.BLOCK,
        attachment=keys.Attachment(1, time.time_ns(), secrets.token_bytes(16)).encode(),
    )
    return topic
