"""The start pose: the last one of an earlier localizer, a known one, or an operator's."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from cairn.components.localizer.config import LocalizerConfig
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.pose_differences import PLACE_M, is_same, slip_covariance
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.planar.messages import is_covariance, planar_covariance, planar_pose
from cairn.planar.odometry import FASTEST_WHEELS
from cairn.planar.poses import Pose, compose, distance, relative
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.system.files import replace_file

# A saved pose is used for so long [s]: a localizer is restarted within seconds; later the robot may
# have been carried anywhere.
_HOLDS_S = 60.0
# The covariance of an operator's pose that has none [m^2, rad^2]: the one that RViz sends.
_OPERATOR = np.diag([0.25, 0.25, 0.0685])


def find_start_pose(
    config: LocalizerConfig, odom: Odometry, stamp_s: float, log: logging.Logger
) -> PoseEstimate | None:
    """Return where the robot is at the first odometry, of `stamp_s` [s]; None if it is unknown."""
    pose = planar_pose(odom.pose.pose)
    file = config.resume_file
    last = load_last_pose(file, stamp_s, pose, log) if file else None
    if last is not None:
        return last
    start = config.start
    if start is None:
        log.info("start pose unknown: searching the map for the robot")
        return None
    covariance = planar_covariance(odom.pose)
    if not is_covariance(covariance):  # drivers that do not know theirs publish -1
        log.warning("odometry has no valid covariance: assuming that it starts at its origin")
        covariance = np.zeros((3, 3))
    drift = math.sqrt(covariance[0, 0] + covariance[1, 1])
    if drift > PLACE_M:
        log.warning(
            "start pose not used, as odometry has drifted by some %.1f m since: searching the map "
            "for the robot",
            drift,
        )
        return None
    spread = np.diag([start.position_sd**2, start.position_sd**2, start.heading_sd**2])
    return PoseEstimate(compose((start.x, start.y, start.theta), pose), spread + covariance)


def operator_pose(message: PoseWithCovariance) -> PoseEstimate:
    """Return the pose of an operator's message, with RViz's covariance if it has none."""
    covariance = planar_covariance(message)
    if not covariance.any() or not is_covariance(covariance):
        covariance = _OPERATOR
    return PoseEstimate(planar_pose(message.pose), covariance)


class LastPose(BaseModel):
    """The file of the last pose: pose in the map, covariance, and odometry at the same time."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    stamp_s: float
    pose: tuple[float, float, float]
    covariance: tuple[float, float, float, float, float, float, float, float, float]
    odometry: tuple[float, float, float]


def save_last_pose(
    file: Path, stamp_s: float, pose: Pose, covariance: NDArray[np.float64], odom: Pose
) -> None:
    """Replace the file atomically; raises `OSError`."""
    last = LastPose(
        stamp_s=stamp_s,
        pose=pose,
        covariance=tuple(covariance.ravel().tolist()),
        odometry=odom,
    )
    # After a power failure the pose is too old to be used: it need not be on the disk at once.
    replace_file(file, last.model_dump_json().encode(), durable=False)


def load_last_pose(
    file: Path, stamp_s: float, odom: Pose, log: logging.Logger
) -> PoseEstimate | None:
    """Return where the robot is at `stamp_s` with odometry at `odom`; None if that is unknown."""
    try:
        last = LastPose.model_validate_json(read_bounded(file, STATE_BYTES))
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        log.warning("last pose in %s not used: %s", file, error)
        return None
    age_s = stamp_s - last.stamp_s
    if not 0.0 <= age_s <= _HOLDS_S:
        return None
    step = relative(last.odometry, odom)
    covariance = np.array(last.covariance).reshape(3, 3)
    moved_m = math.hypot(step[0], step[1])
    is_at_origin = is_same(odom, (0.0, 0.0, 0.0))
    if moved_m > FASTEST_WHEELS.speed * age_s or (is_at_origin and moved_m > PLACE_M):
        # Odometry restarted meanwhile.
        step = (0.0, 0.0, 0.0)
        covariance += slip_covariance()
    pose = compose(last.pose, step)
    log.info(
        "continuing from the last pose: %.1f s old, %.2f m away", age_s, distance(last.pose, pose)
    )
    return PoseEstimate(pose, covariance)
