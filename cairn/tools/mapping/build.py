"""Builds a map from a recording: trajectory, grid map, graph, and how good they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError, to_ns
from cairn.components.replay.recording import OdometryStream, Recording, ScanStream
from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.quality import MapQuality, quality_of
from cairn.files import explain_os_error, replace_file
from cairn.planar.grid import OccupancyCells
from cairn.planar.pose_tracker import sweep_of
from cairn.planar.poses import Pose, between, compose, relative
from cairn.planar.scans import rays_of

Array = NDArray[np.float64]

Progress = Callable[[str, float], None]
"""Called with the name of a stage and its completed share, from 0 to 1."""

_REPORTED = 50  # scans between two reports of progress
# Without odometry, motion is continued over a gap for so many times the time between two scans.
_MOST_PREDICTED = 2.0


@dataclass(frozen=True)
class BuildSettings:
    """How a map is built.

    Attributes:
        mount: pose of the scanner on the robot [m, m, rad].
        scan_only: predict the motion from the scans before, instead of using odometry.
        resolution: size of the grid map's cells [m].
        reach: longer rays only show free space [m].

    """

    mount: Pose = (0.0, 0.0, 0.0)
    scan_only: bool = False
    resolution: float = 0.05
    reach: float = 20.0


@dataclass(frozen=True)
class BuiltMap:
    """A finished map.

    Attributes:
        mapper: the graph.
        grid: the grid map.
        stamps: times of the scans with a pose, as in the recording [ns].
        poses: (n, 3) of the base at these times [m, m, rad].
        quality: figures.

    """

    mapper: Mapper
    grid: OccupancyCells
    stamps: list[int]
    poses: Array
    quality: MapQuality


def build_map(
    recording: Recording,
    name: str,
    settings: BuildSettings,
    progress: Progress,
    mapper: Mapper | None = None,
) -> BuiltMap:
    """Build a map from the scans and the odometry of a recording.

    Args:
        recording: what is mapped.
        name: of the recording, for errors.
        settings: see there.
        progress: is called while the map is built.
        mapper: a map that is continued; None: a new one.

    Raises `CairnError` if the recording has no scans, or no odometry unless `scan_only`.

    """
    scans = recording.scans()
    if scans is None or not scans.messages:
        raise CairnError(
            f"{name}: has no scans, so no map can be built; give a recording with scans"
        )
    odometry = None if settings.scan_only else recording.odometry()
    if odometry is None and not settings.scan_only:
        raise CairnError(
            f"{name}: has no odometry; give --scan-only to build the map from the scans alone, "
            "which succeeds if the robot moved slowly for its scan rate"
        )
    if mapper is None:
        mapper = Mapper(min(settings.reach, float(scans.messages[0].range_max)))
    source = _driven(scans, odometry) if odometry is not None else None
    total = len(scans.messages)
    pose: Pose = (0.0, 0.0, 0.0)
    for number, scan in enumerate(scans.messages):
        if number % _REPORTED == 0:
            progress("scans", number / total)
        stamp = to_ns(scan.header.stamp)
        if source is None:
            pose, motion = _predicted(mapper, stamp, pose), (0.0, 0.0, 0.0)
        else:
            pose, motion = next(source)
        mapper.add_scan(stamp, pose, rays_of(scan, settings.mount, motion).placed(motion))
    progress("scans", 1.0)
    mapper.finish(progress)
    drawing = MapGrid(settings.resolution, settings.reach)
    drawing.renew(mapper.renewals)
    try:
        drawing.update(mapper.keyframes, mapper.graph.poses, mapper.in_map())
        grid = drawing.grid()
    except ValueError as error:
        raise CairnError(
            f"{name}: {error}, so no map can be drawn; give a coarser --resolution"
        ) from error
    poses = mapper.poses()[-total:]
    known = ~np.isnan(poses[:, 0])
    stamps = [
        stamp for stamp, is_known in zip(scans.stamps, known.tolist(), strict=True) if is_known
    ]
    return BuiltMap(mapper, grid, stamps, poses[known], quality_of(mapper, drawing))


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
    try:
        replace_file(path, "".join(lines).encode())
    except OSError as error:
        raise CairnError(f"{path} cannot be written: {explain_os_error(error)}") from error


def _driven(scans: ScanStream, odometry: OdometryStream) -> Iterator[tuple[Pose, Pose]]:
    """Yield the odometry's pose at each scan, and the motion during its sweep."""
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

    for scan in scans.messages:
        sweep = sweep_of(scan, at)
        assert sweep is not None  # `at` knows a pose at any time
        yield sweep.start, sweep.motion


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
