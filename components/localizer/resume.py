"""The robot's last pose on disk, so that a localizer that comes back goes on from there."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from cairn.components.localizer.particles import Estimate
from cairn.files import replace_file
from cairn.planar.poses import Pose, compose, distance, relative

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


def resumed(file: Path, stamp_s: float, odom: Pose, log: logging.Logger) -> Estimate | None:
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
    return Estimate(pose, covariance)
