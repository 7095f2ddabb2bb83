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
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.planar.messages import is_covariance, planar_covariance, planar_pose
from cairn.planar.poses import Pose, compose, distance, relative
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.system.files import replace_file

# A saved pose is used for so long [s]: a localizer is restarted within seconds; later the robot may
# have been carried anywhere.
_HOLDS_S = 60.0
# What may have happened unnoticed: standard deviation of the position [m] and the heading [rad];
# and the same if odometry restarted meanwhile: a robot at 0.6 m/s for half a second. Chosen by
# hand; `lab/constants.yaml` has the effect of half and double.
_UNSEEN_M, _UNSEEN_RAD = 0.05, 0.05
_RESTARTED_M, _RESTARTED_RAD = 0.3, 0.3
# Odometry restarted if it moved faster than this [m/s], the highest speed that motion control
# accepts, with this allowance for jitter of the stamps [m]; or if it is this near to its origin
# [m], and was more than twice as far away before. Chosen by hand; `lab/constants.yaml` has
# the effect of half and double.
_FASTEST, _JITTER_M, _ORIGIN_M = 3.0, 0.1, 0.25
# A known start holds as long as odometry has drifted less than this from its origin [m]. Chosen by
# hand; `lab/constants.yaml` has the effect of half and double.
_START_HOLDS_M = 0.5
# The deviations of an operator's pose without covariance [m], [rad]: those that RViz sends.
_OPERATOR_M, _OPERATOR_RAD = 0.5, math.radians(15.0)


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
    if drift > _START_HOLDS_M:
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
        covariance = np.diag([_OPERATOR_M**2, _OPERATOR_M**2, _OPERATOR_RAD**2])
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
    unseen_m, unseen_rad = _UNSEEN_M, _UNSEEN_RAD
    moved_m = math.hypot(step[0], step[1])
    at_origin = math.hypot(odom[0], odom[1]) < _ORIGIN_M
    if moved_m > _FASTEST * age_s + _JITTER_M or (at_origin and moved_m > 2.0 * _ORIGIN_M):
        step, unseen_m, unseen_rad = (0.0, 0.0, 0.0), _RESTARTED_M, _RESTARTED_RAD
    covariance += np.diag([unseen_m**2, unseen_m**2, unseen_rad**2])
    pose = compose(last.pose, step)
    log.info(
        "continuing from the last pose: %.1f s old, %.2f m away", age_s, distance(last.pose, pose)
    )
    return PoseEstimate(pose, covariance)
