"""The start pose: the one saved by an earlier localizer, a known start, or an operator's."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from cairn.components.localizer.config import LocalizerConfig
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.files import replace_file
from cairn.planar.messages import is_covariance, planar_covariance, planar_pose
from cairn.planar.poses import Pose, compose, distance, relative
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry

Array = NDArray[np.float64]

# After a longer absence [s] the robot may be anywhere.
_HOLDS_S = 60.0
# What may have happened unseen: deviation of the position [m] and the heading [rad].
_UNSEEN_M, _UNSEEN_RAD = 0.05, 0.05
# Faster than this [m/s] odometry has not gone on but begun anew; so it has if it is this near its
# origin [m], and was not before.
_FASTEST, _FRESH_M = 3.0, 0.25


class LastPose(BaseModel):
    """A pose in the map with its covariance, and odometry's pose of the same time."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    stamp_s: float
    pose: tuple[float, float, float]
    covariance: tuple[float, float, float, float, float, float, float, float, float]
    odometry: tuple[float, float, float]


def save(
    file: Path, stamp_s: float, pose: Pose, covariance: NDArray[np.float64], odom: Pose
) -> None:
    """Replace the file, at once or not at all; raises `OSError`."""
    last = LastPose(
        stamp_s=stamp_s,
        pose=pose,
        covariance=tuple(covariance.ravel().tolist()),
        odometry=odom,
    )
    # Until a robot that lost power is up again, the pose is too old to be gone on from.
    replace_file(file, last.model_dump_json().encode(), durable=False)


def load_last_pose(
    file: Path, stamp_s: float, odom: Pose, log: logging.Logger
) -> PoseEstimate | None:
    """Where the robot is at `stamp_s` with odometry at `odom`; None if the file does not tell."""
    try:
        last = LastPose.model_validate_json(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        log.warning("%s does not hold a pose and is not used: %s", file, error)
        return None
    age_s = stamp_s - last.stamp_s
    if not 0.0 <= age_s <= _HOLDS_S:
        return None
    step = relative(last.odometry, odom)
    covariance = np.array(last.covariance).reshape(3, 3)
    unseen_m, unseen_rad = _UNSEEN_M, _UNSEEN_RAD
    far = math.hypot(step[0], step[1])
    fresh = math.hypot(odom[0], odom[1]) < _FRESH_M
    if far > _FASTEST * age_s + 0.1 or (fresh and far > 2.0 * _FRESH_M):
        # Odometry began anew meanwhile: it does not tell how the robot moved.
        step, unseen_m, unseen_rad = (0.0, 0.0, 0.0), 0.3, 0.3
    covariance += np.diag([unseen_m**2, unseen_m**2, unseen_rad**2])
    pose = compose(last.pose, step)
    log.info(
        "going on from the pose of %.1f s ago, %.2f m from there", age_s, distance(last.pose, pose)
    )
    return PoseEstimate(pose, covariance)


# A start is known as long as odometry has drifted less than this from its origin [m].
_START_HOLDS_M = 0.5
# What an operator's word is taken for who states no covariance [m], [rad]: as RViz sends it.
_POINTED_M, _POINTED_RAD = 0.5, math.radians(15.0)


def find_start_pose(
    config: LocalizerConfig, odom: Odometry, stamp_s: float, log: logging.Logger
) -> PoseEstimate | None:
    """Where the robot is at the first odometry, of `stamp_s` [s]; None: it has to be found."""
    pose = planar_pose(odom.pose.pose)
    file = config.resume_file
    last = load_last_pose(file, stamp_s, pose, log) if file else None
    if last is not None:
        return last
    start = config.start
    if start is None:
        log.info("start unknown: looking for the robot by what it sees")
        return None
    covariance = planar_covariance(odom.pose)
    if not is_covariance(covariance):  # drivers say -1 of what they do not know
        log.warning("odometry states no covariance: taken to begin at its origin")
        covariance = np.zeros((3, 3))
    drift = math.sqrt(covariance[0, 0] + covariance[1, 1])
    if drift > _START_HOLDS_M:
        log.warning(
            "the known start no longer holds, as odometry has drifted by some %.1f m since: "
            "looking for the robot by what it sees",
            drift,
        )
        return None
    spread = np.diag([start.position_sd**2, start.position_sd**2, start.heading_sd**2])
    return PoseEstimate(compose((start.x, start.y, start.theta), pose), spread + covariance)


def operator_pose(given: PoseWithCovariance) -> PoseEstimate:
    """An operator's word for where the robot is."""
    covariance = planar_covariance(given)
    if not covariance.any() or not is_covariance(covariance):
        covariance = np.diag([_POINTED_M**2, _POINTED_M**2, _POINTED_RAD**2])
    return PoseEstimate(planar_pose(given.pose), covariance)
