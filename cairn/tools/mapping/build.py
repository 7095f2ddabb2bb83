"""Builds a map from a recording: trajectory, grid map, landmarks, graph, and how good they are."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from heapq import merge
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError, to_ns
from cairn.components.replay_devices.recording import (
    ObservationStream,
    OdometryStream,
    Recording,
    ScanStream,
)
from cairn.components.slam.landmarks import LandmarkReport
from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper, Progress
from cairn.components.slam.quality import MapQuality, quality_of
from cairn.planar.grid import OccupancyCells
from cairn.planar.motion_model import MEASURED, MotionModel
from cairn.planar.mount_estimation import estimate_mount_yaw, seems_upside_down
from cairn.planar.pose_tracker import sweep_of
from cairn.planar.poses import Pose, between, compose, relative, wrap
from cairn.planar.scans import rays_of
from cairn.schemas.nav_msgs import MOST_CELLS
from cairn.system.files import explained, replace_file
from cairn.system.heap import return_free_memory
from cairn.visual_map.observations import Observation, observations_of

Array = NDArray[np.float64]

_KIND_NAMES = {"odom": "odometry", "truth": "true poses"}  # of the kinds of recorded topics
# Without odometry, motion is continued over a gap for so many times the time between two scans.
_MOST_PREDICTED = 2.0
_FARTHEST_LANDMARK_M = 50.0  # surfaces are irrelevant for a map without scans
# A map whose scans fit worse, from 0 to 1, may be of a scanner with a wrong mount.
_POOR_FIT = 0.6
# Cells that are drawn beside what scans show, in each direction; and the largest size of cells [m]
# to which a map is made coarser by itself.
_AROUND, _COARSEST_M = 256, 0.5
# So far from the yaw by motion [rad] the yaw of a mount is wrong, as in `cairn recording info`.
_OFF_RAD = math.radians(5.0)


@dataclass(frozen=True)
class BuildSettings:
    """How a map is built.

    Attributes:
        mount: pose of the scanner on the robot [m, m, rad]; None: as the recording says, else at
            the robot's center.
        scan_only: predict the motion from the scans before, instead of using odometry.
        model: the uncertainty of odometry.
        resolution: size of the grid map's cells [m].
        reach: longer rays only show free space [m].

    """

    mount: Pose | None = None
    scan_only: bool = False
    model: MotionModel = MEASURED
    resolution: float = 0.05
    reach: float = 20.0


@dataclass(frozen=True)
class BuiltMap:
    """A finished map.

    Attributes:
        mapper: the graph.
        grid: the grid map; None if the recording has no scans.
        landmarks: the recognized objects, and what became of their observations.
        stamps: times of the scans with a pose, as in the recording [ns]; without scans, those of
            odometry and observations.
        poses: (n, 3) of the base at these times [m, m, rad].
        quality: figures.
        hint: what may be wrong, "" if nothing.

    """

    mapper: Mapper
    grid: OccupancyCells | None
    landmarks: LandmarkReport
    stamps: list[int]
    poses: Array
    quality: MapQuality
    hint: str


def build_map(
    recording: Recording,
    name: str,
    settings: BuildSettings,
    progress: Progress,
    mapper: Mapper | None = None,
) -> BuiltMap:
    """Build a map from the scans, the observations of objects and the odometry of a recording.

    Args:
        recording: what is mapped.
        name: of the recording, for errors.
        settings: see there.
        progress: is called while the map is built.
        mapper: a map that is continued, made with `settings.model`; None: a new one.

    Raises `CairnError` if the recording has neither scans nor observations, or no odometry unless
    `scan_only`, or if it has no place of the map that is continued.

    """
    scans, seen = recording.scans(), recording.observations()
    if scans is None and seen is None:
        has = sorted({one.kind for one in recording.topics() if one.kind is not None})
        raise CairnError(
            f"{name}: has no scans and no observations of objects, so no map can be built, only "
            f"{' and '.join(_KIND_NAMES.get(kind, kind) for kind in has) or 'other topics'}; give "
            "a recording with one of them"
        )
    odometry = None if settings.scan_only else recording.odometry()
    if odometry is None and not (settings.scan_only and scans is not None):
        raise CairnError(
            f"{name}: has no odometry; give --scan-only to build the map from the scans alone, "
            "which succeeds if the robot moved slowly for its scan rate"
        )
    if mapper is None:
        reach = min(settings.reach, float(scans.messages[0].range_max)) if scans else None
        mapper = Mapper(reach or _FARTHEST_LANDMARK_M, settings.model)
    earlier = len(mapper.keyframes)
    mount = settings.mount or _recorded_mount(recording)
    _add_records(mapper, scans, seen, odometry, mount, progress)
    mapper.finish(progress)
    return_free_memory()
    if earlier:
        _check_joined(mapper, earlier, name)
    low, high = _bounds(mapper, settings.reach)
    resolution = _resolution(high - low, settings.resolution)
    drawing = MapGrid(resolution, settings.reach)
    try:
        if scans is not None:
            drawing.counts.reserve(low, high)
        drawing.counts.renew(mapper.renewals)
        drawing.update(mapper.keyframes, mapper.graph.poses, mapper.in_map())
        grid = drawing.counts.grid() if scans is not None else None
    except ValueError as error:
        raise CairnError(
            f"{name}: {error}, so no map can be drawn; give a coarser --resolution"
        ) from error
    recorded = dict(zip(scans.stamps, scans.recorded_stamps, strict=True)) if scans else None
    poses = mapper.poses()
    kept = [
        k
        for k, step in enumerate(mapper.trajectory)
        if not np.isnan(poses[k, 0]) and (recorded is None or step.stamp_ns in recorded)
    ]
    stamps = [mapper.trajectory[k].stamp_ns for k in kept]
    if recorded is not None:
        stamps = [recorded[stamp] for stamp in stamps]
    quality = quality_of(mapper, drawing)
    hint = _mount_hint(name, quality, mount, scans, odometry)
    if resolution > settings.resolution:
        hint = (
            f"{name}: the map is drawn with cells of {resolution:g} m; with cells of "
            f"{settings.resolution:g} m, it would have more than {MOST_CELLS:,}"
            + (f"\n{hint}" if hint else "")
        )
    return BuiltMap(mapper, grid, mapper.landmarks(), stamps, poses[kept], quality, hint)


def _bounds(mapper: Mapper, reach: float) -> tuple[Array, Array]:
    """Return the least and the largest x, y (2,) [m] that scans show up to `reach` [m]."""
    low, high = np.zeros(2), np.zeros(2)
    for number in np.flatnonzero(mapper.in_map()).tolist():
        position = mapper.graph.poses[number, :2]
        rays = mapper.keyframes[number].rays
        ranges = rays.rays().ranges if rays is not None else np.zeros(0)
        far = float(ranges[ranges <= reach].max(initial=0.0))
        low, high = np.minimum(low, position - far), np.maximum(high, position + far)
    return low, high


def _resolution(size: Array, finest: float) -> float:
    """Return the size of cells [m] of a map of some size (2,) [m].

    It is the finest one, doubled until there are not too many cells.
    """
    resolution = finest
    while 2.0 * resolution <= _COARSEST_M and np.prod(size / resolution + _AROUND) > MOST_CELLS:
        resolution *= 2.0
    return resolution


def _check_joined(mapper: Mapper, earlier: int, name: str) -> None:
    """Raise `CairnError` if nothing joins the recording to the `earlier` keyframes of its map."""
    in_map = mapper.in_map()
    if in_map[:earlier].any() and any(in_map[step.keyframe] for step in mapper.trajectory):
        return
    raise CairnError(
        f"{name}: no place of the map that it is to extend is recognized in it; check that both "
        "are of one building and that the scanner's mount is right, or build a map of its own "
        "without --extend"
    )


def _add_records(
    mapper: Mapper,
    scans: ScanStream | None,
    seen: ObservationStream | None,
    odometry: OdometryStream | None,
    mount: Pose,
    progress: Progress,
) -> None:
    """Add everything to the map, in the order of its times."""
    at = _interpolated(odometry) if odometry is not None else None
    streams: list[list[tuple[int, int, int]]] = []
    total = 0
    for kind, stamps in enumerate(
        (
            # Between scans, odometry is taken from the stream when it is needed.
            odometry.stamps if odometry is not None and scans is None else (),
            scans.stamps if scans is not None else (),
            seen.stamps if seen is not None and at is not None else (),
        )
    ):
        total += len(stamps)
        streams.append([(stamp, kind, k) for k, stamp in enumerate(stamps)])
    virtual: Pose = (0.0, 0.0, 0.0)
    for number, (stamp, kind, k) in enumerate(merge(*streams)):
        done = f"{number:,} of {total:,} records, {mapper.closer.counts.accepted:,} loops closed"
        progress("records", number / total, done)
        if kind == _ODOMETRY and odometry is not None:
            x, y, theta = odometry.poses[k].tolist()
            mapper.add_odometry(stamp, (x, y, theta))
        elif kind == _SCAN and scans is not None:
            scan = scans.messages[k]
            motion: Pose = (0.0, 0.0, 0.0)
            if at is None:
                virtual = pose = _predicted(mapper, stamp, virtual)
            else:
                sweep = sweep_of(scan, at)
                assert sweep is not None  # `at` knows a pose at any time
                pose, motion = sweep.start, sweep.motion
            mapper.add_scan(
                to_ns(scan.header.stamp), pose, rays_of(scan, mount, motion).placed(motion)
            )
        elif seen is not None and at is not None:
            mapper.add_observations(stamp, at(stamp), _observations(seen, k))


_ODOMETRY, _SCAN = 0, 1  # kinds of records, in the order in which those of one time are added


def _observations(seen: ObservationStream, number: int) -> list[Observation]:
    if seen.messages is not None:
        return observations_of(seen.messages[number])
    return [
        Observation(
            one.object_id, one.range_m, one.bearing, one.range_variance, one.bearing_variance
        )
        for one in seen.frames[number]
        if one.object_id is not None
    ]


def _mount_hint(
    name: str,
    quality: MapQuality,
    mount: Pose,
    scans: ScanStream | None,
    odometry: OdometryStream | None,
) -> str:
    """Return the hint that the scanner's mount may be wrong; "" if nothing indicates that."""
    if scans is None:
        return ""
    yaw = None
    if odometry is not None:
        at = _interpolated(odometry)
        poses = np.array([at(stamp) for stamp in scans.stamps])
        if seems_upside_down(scans.messages, poses):
            return (
                f"{name}: what the scanner sees turns with the robot: it is upside down, or its "
                "beams are in the opposite order. A bag says so by /tf_static or "
                "/robot_description; else reverse the ranges of the recording"
            )
        yaw = estimate_mount_yaw(scans.messages, poses)
    question = f"is the mount of the scanner, ({mount[0]:g}, {mount[1]:g}, {mount[2]:g}), right?"
    if yaw is not None and abs(wrap(yaw.yaw - mount[2])) > max(_OFF_RAD, 3.0 * yaw.deviation):
        return (
            f"{name}: the scanner's yaw by the robot's motion is {yaw.yaw:.2f} +- "
            f"{yaw.deviation:.2f} rad: {question} Try --scanner "
            f"{mount[0]:g},{mount[1]:g},{yaw.yaw:.2f}"
        )
    if quality.fit < _POOR_FIT:
        return (
            f"{name}: scans do not fit the map with any pose (fit {quality.fit:.2f} of 1): "
            f"{question} Give it by --scanner X,Y,THETA"
        )
    return ""


def write_trajectory(path: Path, stamps: list[int], poses: Array) -> None:
    """Write poses in the format of the TUM benchmark: `time x y z qx qy qz qw` per line.

    Times [s] are written exactly, with six decimals or nine. Raises `CairnError` if the file cannot
    be written.
    """
    lines = []
    for stamp, (x, y, theta) in zip(stamps, poses.tolist(), strict=True):
        seconds, rest = divmod(stamp, 1_000_000_000)
        time = f"{seconds}.{rest // 1000:06d}" if rest % 1000 == 0 else f"{seconds}.{rest:09d}"
        z, w = np.sin(theta / 2), np.cos(theta / 2)
        lines.append(f"{time} {x:.6f} {y:.6f} 0 0 0 {z:.9f} {w:.9f}\n")
    with explained(f"{path} cannot be written"):
        replace_file(path, "".join(lines).encode())


def _recorded_mount(recording: Recording) -> Pose:
    mount = recording.mount()
    return (0.0, 0.0, 0.0) if mount is None else mount.pose


def _interpolated(odometry: OdometryStream) -> Callable[[int], Pose]:
    """Return a function of a time [ns]: the pose of odometry then; the first or last outside."""
    stamps = np.asarray(odometry.stamps, np.int64)
    poses = [(x, y, theta) for x, y, theta in odometry.poses.tolist()]

    def at(stamp: int) -> Pose:
        after = int(np.searchsorted(stamps, stamp, side="right"))
        if after == 0:
            return poses[0]
        if after == len(stamps):
            return poses[-1]
        before_ns, after_ns = int(stamps[after - 1]), int(stamps[after])
        return between(poses[after - 1], poses[after], (stamp - before_ns) / (after_ns - before_ns))

    return at


def _predicted(mapper: Mapper, stamp: int, last: Pose) -> Pose:
    """Return the odometry of a robot that goes on as between the last two scans.

    `last` is that of the last scan.
    """
    steps = mapper.trajectory[-2:]
    if len(steps) < 2:
        return last
    before, at = (compose(mapper.graph.pose(s.keyframe), s.offset) for s in steps)
    passed = steps[1].stamp_ns - steps[0].stamp_ns
    share = min(_MOST_PREDICTED, (stamp - steps[1].stamp_ns) / passed) if passed > 0 else 1.0
    return compose(last, between((0.0, 0.0, 0.0), relative(before, at), share))
