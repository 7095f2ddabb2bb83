"""The calibration of odometry: its lag, gains and veer, estimated together with the map."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.landmarks import LandmarkBuilder
from cairn.components.slam.odometry_log import OdometryCalibration, OdometryLog, OdometryPath
from cairn.components.slam.pose_graph import AGREES, Edge, EdgeKind, PoseGraph, relative_all
from cairn.planar.motion_model import MotionModel, move_pose, odometry_step
from cairn.planar.odometry_gains import GainEstimator
from cairn.planar.poses import Pose, compose, relative

Array = NDArray[np.float64]

# How far gains, lag [s] and veer [rad/m] usually are from those that are configured.
_USUAL = (0.1, 0.1, 0.1, 0.01)
# The estimate is complete after a change below this share of that, or after so many.
_ENOUGH, _MOST_CHANGES = 0.01, 8


@dataclass(frozen=True)
class CalibrationEstimate:
    """A calibration with the standard deviations of its attributes, in the same units.

    A deviation near that of the prior, 0.1, means that the recording does not show the value.
    """

    calibration: OdometryCalibration
    deviations: OdometryCalibration


NOT_ESTIMATED = CalibrationEstimate(OdometryCalibration(), OdometryCalibration(*_USUAL))
"""Odometry that is right, as far as it usually is."""


def with_gains(before: CalibrationEstimate, gains: GainEstimator) -> CalibrationEstimate:
    """Return a calibration with gains that were estimated while driving, and its lag."""
    (forward,), (turn, veer) = gains.forward.tolist(), gains.turn.tolist()
    forward_sd, turn_sd, veer_sd = gains.deviations
    return CalibrationEstimate(
        OdometryCalibration(forward, turn, before.calibration.lag_s, veer),
        OdometryCalibration(forward_sd, turn_sd, before.deviations.lag_s, veer_sd),
    )


def odometry_edge(
    first: int, second: int, stamps: NDArray[np.int64], path: OdometryPath, model: MotionModel
) -> Edge:
    """Return the constraint by odometry between two keyframes, from the `stamps` [ns] of all."""
    motion = path.motion(int(stamps[first]), int(stamps[second]), model)
    return Edge(EdgeKind.ODOMETRY, first, second, *motion)


def corrected_step(
    edge: Edge,
    stated: Pose,
    by_odometry: Array,
    before: OdometryCalibration,
    now: CalibrationEstimate,
) -> Edge:
    """Return a step that was tracked with other gains of the odometry.

    Args:
        edge: the step, which scans show in part.
        stated: the motion by odometry, not calibrated.
        by_odometry: (3, 3) how the step changes with it, in the frame of its end.
        before: the calibration when it was tracked.
        now: the calibration that is right.

    """
    step = odometry_step(stated)
    old, new = (
        move_pose((0.0, 0.0, 0.0), one.corrected(step)) for one in (before, now.calibration)
    )
    x, y, turn = (by_odometry @ relative(old, new)).tolist()
    return replace(edge, measured=compose(edge.measured, (x, y, turn)))


def estimate_calibration(
    start: CalibrationEstimate,
    log: OdometryLog,
    model: MotionModel,
    stamps: NDArray[np.int64],
    graph: PoseGraph,
    builder: LandmarkBuilder,
) -> CalibrationEstimate:
    """Estimate the calibration, and use it in the graph, which has been optimized.

    All steps between successive keyframes count, those that scans show and those that landmarks
    show. Without either the result is `start`, which was estimated while driving.
    """
    now = origin = np.array(astuple(start.calibration))
    known, usual = np.array(astuple(start.deviations)), np.array(_USUAL)
    information, covariance = np.diag(known**-2.0), np.diag(known**2.0)
    covered = stamps >= log.path(start.calibration).origin_ns
    pairs = [
        (edge.first, edge.second)
        for edge in graph.edges
        if edge.kind in (EdgeKind.STEP, EdgeKind.ODOMETRY) and covered[edge.first]
    ]
    ends = np.array(pairs, np.int64).reshape(-1, 2)

    def motions(path: OdometryPath) -> Array:
        poses = path.at(stamps)
        return relative_all(poses[ends[:, 0]], poses[ends[:, 1]])

    for _ in range(_MOST_CHANGES if pairs else 0):
        path = log.path(OdometryCalibration(*now))
        by_motion, by_sighting = [], []
        for k, step in enumerate(np.sqrt(np.diag(covariance)).tolist()):
            low, high = now.copy(), now.copy()
            low[k] -= step
            high[k] += step
            before, after = (log.path(OdometryCalibration(*one)) for one in (low, high))
            by_motion.append(relative_all(motions(before), motions(after)) / (2 * step))
            change = builder.measured(after, stamps) - builder.measured(before, stamps)
            by_sighting.append(change / (2 * step))
        edges = [odometry_edge(first, second, stamps, path, model) for first, second in pairs]
        change, covariance = graph.correction(
            edges,
            np.stack(by_motion, axis=2),
            np.stack(by_sighting, axis=2),
            origin - now,
            information,
        )
        now = np.clip(now + change, *(origin + k * AGREES * usual for k in (-1, 1)))
        if graph.depends_on_odometry:
            # Steps without scans, and sightings, follow from odometry.
            path = log.path(OdometryCalibration(*now))
            graph.edges = [
                odometry_edge(edge.first, edge.second, stamps, path, model)
                if edge.kind is EdgeKind.ODOMETRY and covered[edge.first]
                else edge
                for edge in graph.edges
            ]
            builder.rebuild(path, stamps)
            graph.minimize()
        if (np.abs(change) < _ENOUGH * usual).all():
            break
    deviations = np.sqrt(np.diag(covariance)).tolist()
    return CalibrationEstimate(OdometryCalibration(*now.tolist()), OdometryCalibration(*deviations))
