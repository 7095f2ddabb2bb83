"""Runs localizer and map builder over an MRCLAM recording without the middleware."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.config import LocalizationSettings
from cairn.components.localizer.localization import EvidenceFrame, Localization
from cairn.components.localizer.messages import evidence_message
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.odometry import CommandedTrack
from cairn.components.map_builder.landmark_map import LandmarkMap
from cairn.components.map_builder.landmark_messages import evidence_of
from cairn.components.replay_devices.mrclam import MrclamDataset, range_bearing_variance
from cairn.schemas.std_msgs import Header
from cairn.visual_map.landmarks import LandmarkChange, LandmarkRecord, LandmarkState
from cairn.visual_map.observations import Observation

# Parameters of a base without odometry; they matter only in gaps, which MRCLAM does not have.
LAG_S, GAINS = 0.17, (0.95, 0.93)
STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RobotRecording:
    """One robot's records; times [s] from the first odometry record."""

    odometry: NDArray[np.float64]
    frames: list[tuple[float, list[Observation]]]
    truth: NDArray[np.float64]
    positions: dict[int, tuple[float, float]]


@dataclass
class ReplayOutcome:
    """Poses (n, 4) of time, x, y, heading; the final map; changes with their times."""

    poses: NDArray[np.float64]
    objects: dict[int, LandmarkRecord]
    changes: list[tuple[float, LandmarkChange]] = field(default_factory=list)
    located_at: float = math.nan
    relocalized: int = 0


def load(dataset: MrclamDataset, robot: int) -> RobotRecording:
    subjects = dataset.subjects()
    odometry = dataset.odometry(robot)
    origin = odometry[0, 0]
    seen = dataset.observations(robot)
    frames: list[tuple[float, list[Observation]]] = []
    for t, code, range_m, bearing in zip(
        seen.time - origin, seen.barcode, seen.range_m, seen.bearing, strict=True
    ):
        subject = subjects.get(int(code), 0)
        if subject < 6:
            continue
        observation = Observation(
            subject, float(range_m), float(bearing), *range_bearing_variance(range_m)
        )
        if frames and frames[-1][0] == t:
            frames[-1][1].append(observation)
        else:
            frames.append((float(t), [observation]))
    truth = dataset.truth(robot)
    shift = np.array([origin, 0.0, 0.0, 0.0])
    positions = {s.object_id: (s.x, s.y) for s in dataset.landmarks()}
    return RobotRecording(odometry - shift[:3], frames, truth - shift, positions)


def landmarks_of(visual_map: LandmarkMap) -> list[Landmark]:
    return [
        Landmark(
            o.object_id,
            o.position.x,
            o.position.y,
            o.position.xx,
            o.position.xy,
            o.position.yy,
            o.reliability,
            o.state is LandmarkState.LIVE,
        )
        for o in visual_map.landmarks.values()
        if o.position is not None
    ]


def true_pose(recording: RobotRecording, t: float) -> tuple[float, float, float]:
    truth = recording.truth
    heading = np.interp(t, truth[:, 0], np.unwrap(truth[:, 3]))
    return (
        float(np.interp(t, truth[:, 0], truth[:, 1])),
        float(np.interp(t, truth[:, 0], truth[:, 2])),
        float(heading),
    )


def run(
    recording: RobotRecording,
    objects: list[LandmarkRecord],
    settings: LocalizationSettings,
    seed: int,
    start: tuple[float, float, float] | None,
    update_map: bool = True,
    begin: float = 0.0,
) -> ReplayOutcome:
    localization = Localization(
        settings, CommandedTrack(LAG_S, *GAINS), np.random.default_rng(seed)
    )
    visual_map = LandmarkMap(objects)
    localization.set_landmarks(landmarks_of(visual_map))
    if start is not None:
        localization.set_pose(start, np.diag([0.05**2, 0.05**2, 0.03**2]))
    outcome = ReplayOutcome(np.empty((0, 4)), visual_map.landmarks)
    poses: list[tuple[float, float, float, float]] = []
    frames = [f for f in recording.frames if f[0] >= begin]
    ticks = np.arange(begin + 0.5, recording.odometry[-1, 0], 0.5)
    events: list[tuple[float, list[Observation] | None]] = [
        *frames,
        *((float(t), None) for t in ticks),
    ]
    events.sort(key=lambda event: event[0])
    rows = recording.odometry[recording.odometry[:, 0] >= begin]
    k, count = 0, len(rows)
    times, forward, turn = rows[:, 0].tolist(), rows[:, 1].tolist(), rows[:, 2].tolist()
    for t, observations in events:
        while k < count and times[k] <= t:
            localization.add_odometry(times[k], STILL, forward[k], turn[k])
            k += 1
        if observations is None:
            localization.advance(t)
        else:
            frame = localization.fuse_objects(t, observations)
            if frame is not None and update_map:
                _update(t, localization, visual_map, frame, outcome)
        if localization.located:
            if math.isnan(outcome.located_at):
                outcome.located_at = t
            poses.append((t, *localization.pose().mean))
    outcome.poses = np.array(poses)
    return outcome


def _update(
    t: float,
    localization: Localization,
    visual_map: LandmarkMap,
    frame: EvidenceFrame,
    outcome: ReplayOutcome,
) -> None:
    evidence = evidence_of(evidence_message(Header(), frame))
    changes = list(visual_map.apply(evidence, t).changes)
    if frame.relocalized:
        outcome.relocalized += 1
        changes += visual_map.undo(localization.confirmed_until)[1]
    outcome.changes += [(t, c) for c in changes]
    localization.set_landmarks(landmarks_of(visual_map))


def errors(
    outcome: ReplayOutcome, recording: RobotRecording, step: float = 0.1
) -> NDArray[np.float64]:
    """Return position errors [m] (n, 2: time, error) from the first pose on."""
    poses = outcome.poses
    grid = np.arange(poses[0, 0], min(poses[-1, 0], recording.truth[-1, 0]), step)
    truth = recording.truth
    dx = np.interp(grid, poses[:, 0], poses[:, 1]) - np.interp(grid, truth[:, 0], truth[:, 1])
    dy = np.interp(grid, poses[:, 0], poses[:, 2]) - np.interp(grid, truth[:, 0], truth[:, 2])
    return np.stack([grid, np.hypot(dx, dy)], axis=1)


def stressed(recording: RobotRecording, random: np.random.Generator) -> RobotRecording:
    """Return the recording as that of another robot in another hall.

    It may be mirrored; it has another base (commands scaled by up to 7 %), camera (range scaled by
    up to 4 %, bearing off by 0.7 degrees), up to 2 % gross errors (half of them misread barcodes
    for 2 s), fewer frames, and one blind stretch of 60 to 200 s.
    """
    odometry = recording.odometry * np.array(
        [1.0, random.uniform(0.93, 1.07), random.uniform(0.93, 1.07)]
    )
    truth = recording.truth.copy()
    positions = dict(recording.positions)
    side = 1.0 if random.random() < 0.5 else -1.0
    odometry[:, 2] *= side
    truth[:, 2] *= side
    truth[:, 3] *= side
    positions = {i: (x, side * y) for i, (x, y) in positions.items()}
    scale, offset = random.uniform(0.96, 1.04), random.normal(0.0, math.radians(0.7))
    gross, kept = random.uniform(0.0, 0.02), random.uniform(0.3, 1.0)
    end = float(odometry[-1, 0])
    blind_from = random.uniform(60.0, end - 200.0)
    blind_to = blind_from + random.uniform(60.0, 200.0)
    frames = []
    misread: tuple[float, int, int] = (-1.0, 0, 0)  # until, barcode, mistaken as
    ids = sorted(positions)
    for t, observations in recording.frames:
        if blind_from < t < blind_to or random.random() > kept:
            continue
        seen = []
        for s in observations:
            object_id, range_m, bearing = s.object_id, s.range_m * scale, side * s.bearing + offset
            if random.random() < gross / 4:
                misread = (t + 2.0, object_id, int(random.choice(ids)))
            if t < misread[0] and object_id == misread[1]:
                object_id = misread[2]
            if random.random() < gross / 2:
                range_m, bearing = random.uniform(0.5, 6.0), random.uniform(-0.5, 0.5)
            seen.append(Observation(object_id, range_m, bearing, *range_bearing_variance(range_m)))
        frames.append((t, seen))
    return RobotRecording(odometry, frames, truth, positions)
