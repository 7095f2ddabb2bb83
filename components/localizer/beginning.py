"""Where a localizer begins: where it left off, at a known start, or anywhere."""

from __future__ import annotations

import logging
import math

import numpy as np

from cairn.components.localizer.config import LocalizerConfig
from cairn.components.localizer.particles import Estimate
from cairn.components.localizer.resume import resumed
from cairn.planar.messages import is_covariance, planar_covariance, planar_pose
from cairn.planar.poses import compose
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry

# A start is known as long as odometry has drifted less than this from its origin [m].
_START_HOLDS_M = 0.5
# What an operator's word is taken for who states no covariance [m], [rad]: as RViz sends it.
_POINTED_M, _POINTED_RAD = 0.5, math.radians(15.0)


def first_pose(
    config: LocalizerConfig, odom: Odometry, stamp_s: float, log: logging.Logger
) -> Estimate | None:
    """Where the robot is at the first odometry, of `stamp_s` [s]; None: it has to be found."""
    pose = planar_pose(odom.pose.pose)
    file = config.resume_file
    last = resumed(file, stamp_s, pose, log) if file else None
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
    return Estimate(compose((start.x, start.y, start.theta), pose), spread + covariance)


def pointed_out(given: PoseWithCovariance) -> Estimate:
    """An operator's word for where the robot is."""
    covariance = planar_covariance(given)
    if not covariance.any() or not is_covariance(covariance):
        covariance = np.diag([_POINTED_M**2, _POINTED_M**2, _POINTED_RAD**2])
    return Estimate(planar_pose(given.pose), covariance)
