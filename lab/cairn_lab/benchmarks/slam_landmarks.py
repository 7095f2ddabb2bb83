"""Maps of landmarks from observations and commanded velocities alone: MRCLAM, robots 2 and 5.

    python -m cairn_lab.benchmarks slam_landmarks

No landmark position is given. The map is aligned rigidly to the surveyed landmarks, and with it the
trajectory, which is compared with the motion capture. The two halves of each recording are mapped,
too, each without the other. `python -m cairn_lab.benchmarks.slam_landmarks DATASET_DIR 1 2 3 4 5`
prints the results of other robots and data sets.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from heapq import merge
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay_devices.mrclam import MrclamRecording
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.odometry_calibration import CalibrationEstimate
from cairn.planar.motion_model import COMMANDED
from cairn.planar.poses import Pose
from cairn.visual_map.observations import Observation
from cairn_lab.benchmarks.lockstep import DATASET
from cairn_lab.benchmarks.result import Metric

Array = NDArray[np.float64]

ROBOTS = (2, 5)
MOST_LANDMARK_M, MOST_TRAJECTORY_M = 0.15, 0.30
SECOND = 1_000_000_000


@dataclass(frozen=True)
class LandmarkRun:
    """The map of one recording: root mean square errors [m], and how it was made."""

    landmarks: int
    landmark_error: float
    trajectory_error: float
    largest_trajectory_error: float
    normalized_error: float
    calibration: CalibrationEstimate
    cpu_s: float


def run(recording: MrclamRecording, share: tuple[float, float] = (0.0, 1.0)) -> LandmarkRun:
    """Map a part of a recording, from one share of its duration to another."""
    begin, end = recording.span()
    first, last = (begin + round(one * (end - begin)) for one in share)
    before = time.process_time()
    mapper = Mapper(10.0, COMMANDED)
    odometry, seen = recording.odometry(), recording.observations()
    records = merge(
        ((stamp, 0, k) for k, stamp in enumerate(odometry.stamps)),
        ((stamp, 1, k) for k, stamp in enumerate(seen.stamps)),
    )
    poses = odometry.poses.tolist()
    pose: Pose = (0.0, 0.0, 0.0)
    for stamp, kind, k in records:
        if not first <= stamp <= last:
            continue
        if kind == 0:
            x, y, theta = poses[k]
            pose = x, y, theta
            mapper.add_odometry(stamp, pose)
        else:
            mapper.add_observations(
                stamp,
                pose,
                [
                    Observation(
                        one.object_id,
                        one.range_m,
                        one.bearing,
                        one.range_variance,
                        one.bearing_variance,
                    )
                    for one in seen.frames[k]
                    if one.object_id is not None
                ],
            )
    mapper.finish()
    return _judged(mapper, recording, time.process_time() - before)


def _judged(mapper: Mapper, recording: MrclamRecording, cpu_s: float) -> LandmarkRun:
    surveyed = {o.object_id: (o.x, o.y) for o in recording.landmark_map().objects}
    found = [one for one in mapper.landmarks().landmarks if one.object_id in surveyed]
    points = np.array([(one.position.x, one.position.y) for one in found])
    true = np.array([surveyed[one.object_id] for one in found])
    p, q = points - points.mean(axis=0), true - true.mean(axis=0)
    product = p.T @ q
    turn = math.atan2(product[0, 1] - product[1, 0], product[0, 0] + product[1, 1])
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    errors = p @ rotation - q
    normalized = [
        error
        @ rotation.T
        @ np.linalg.inv([[o.position.xx, o.position.xy], [o.position.xy, o.position.yy]])
        @ (error @ rotation.T)
        for error, o in zip(errors, found, strict=True)
    ]
    truth = recording.truth()
    times = np.array([step.stamp_ns for step in mapper.trajectory])
    stamps = np.array(truth.stamps)
    known = (times >= stamps[0]) & (times <= stamps[-1])
    known &= np.diff(stamps)[np.searchsorted(stamps, times).clip(1, len(stamps) - 1) - 1] < SECOND
    aligned = (mapper.poses()[:, :2] - points.mean(axis=0)) @ rotation + true.mean(axis=0)
    x, y = (np.interp(times, stamps, truth.poses[:, k]) for k in (0, 1))
    off = np.hypot(aligned[:, 0] - x, aligned[:, 1] - y)[known]
    return LandmarkRun(
        landmarks=len(found),
        landmark_error=float(np.sqrt((errors**2).sum(axis=1).mean())),
        trajectory_error=float(np.sqrt((off**2).mean())),
        largest_trajectory_error=float(off.max()),
        normalized_error=float(np.mean(normalized)),
        calibration=mapper.calibration,
        cpu_s=cpu_s,
    )


def measure() -> list[Metric]:
    """Return the errors of all runs, with their limits."""
    metrics = []
    for robot in ROBOTS:
        recording = MrclamRecording(DATASET, robot)
        for name, share in (
            ("", (0.0, 1.0)),
            (", 1st half", (0.0, 0.5)),
            (", 2nd half", (0.5, 1.0)),
        ):
            one = run(recording, share)
            calibration = one.calibration.calibration
            metrics += [
                Metric(
                    f"robot {robot}{name}: landmarks",
                    one.landmark_error,
                    "m rms",
                    at_most=MOST_LANDMARK_M,
                    note=f"{one.landmarks} landmarks; normalized error {one.normalized_error:.1f} "
                    "(2 is right)",
                ),
                Metric(
                    f"robot {robot}{name}: trajectory",
                    one.trajectory_error,
                    "m rms",
                    at_most=MOST_TRAJECTORY_M,
                    note=f"largest {one.largest_trajectory_error:.2f} m; lag "
                    f"{calibration.lag_s:.2f} s, gains {calibration.forward_gain:.2f} and "
                    f"{calibration.turn_gain:.2f}; {one.cpu_s:.0f} s of processor time",
                ),
            ]
    return metrics


def main() -> None:
    """Print the results of the robots of a data set."""
    for robot in map(int, sys.argv[2:]):
        print(robot, run(MrclamRecording(Path(sys.argv[1]), robot)), flush=True)


if __name__ == "__main__":
    main()
