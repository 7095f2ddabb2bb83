"""Keyframes: the scans that the map consists of, and the submaps that group them."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.point_cloud import NOTHING, PointCloud, cloud_of
from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose, relative
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

# Size of the cells by which scans of the same surfaces find each other [m].
_PLACE = 0.5
# Whole numbers of `ScanSurfaces`.
_STEPS, _NO_SURFACE = 32767, -32768


@dataclass(frozen=True, slots=True)
class ScanRays:
    """The rays of a scan in few numbers: starts and directions change evenly from first to last.

    `first` and `last` are start x, y [m] and direction [rad] of the first and the last ray, in the
    frame of the base at the scan's pose; `ranges` (n,) [m] as in `Rays`.
    """

    first: Pose
    last: Pose
    ranges: Float32Array
    reach: float

    def rays(self) -> Rays:
        """Return the rays."""
        share = np.linspace(0.0, 1.0, len(self.ranges))[:, None]
        first, last = np.array(self.first), np.array(self.last)
        both = first + share * (last - first)
        return Rays(
            np.ascontiguousarray(both[:, :2]),
            np.ascontiguousarray(both[:, 2]),
            self.ranges.astype(np.float64),
            self.reach,
        )


def scan_rays(rays: Rays) -> ScanRays:
    """Return the rays of a scan in few numbers."""
    x, y = rays.starts[0].tolist()
    last_x, last_y = rays.starts[-1].tolist()
    first, last = float(rays.angles[0]), float(rays.angles[-1])
    return ScanRays(
        (x, y, first), (last_x, last_y, last), rays.ranges.astype(np.float32), rays.reach
    )


@dataclass(frozen=True, slots=True)
class ScanSurfaces:
    """The surfaces of a scan in few bytes: a `PointCloud` in whole numbers.

    `values` (n, 3) are x and y in steps of `step` [m], and the direction of the normal in 32767ths
    of a half turn, or -32768 without a surface. The farthest point has 32767 steps: the error of
    a point is at most 1/65000 of that distance, 0.5 mm at 30 m.
    """

    values: NDArray[np.int16]
    step: float

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.values)

    def cloud(self) -> PointCloud:
        """Return the points with their normals."""
        return placed_together([(self, (0.0, 0.0, 0.0))])


def placed_together(surfaces: Sequence[tuple[ScanSurfaces, Pose]]) -> PointCloud:
    """Return the points of several scans, each in the frame in which the scan is at the pose."""
    count = sum(one.count for one, _ in surfaces)
    points, normals = np.empty((count, 2)), np.empty((count, 2))
    start = 0
    for one, (x, y, turn) in surfaces:
        end = start + one.count
        _place(one.values, one.step, x, y, turn, points[start:end], normals[start:end])
        start = end
    return PointCloud(points, normals)


@compiled(
    "void(int16[:, ::1], float64, float64, float64, float64, float64[:, ::1], float64[:, ::1])"
)
def _place(
    values: NDArray[np.int16],
    step: float,
    x: float,
    y: float,
    turn: float,
    points: Array,
    normals: Array,
) -> None:
    cosine, sine = math.cos(turn), math.sin(turn)
    for i in range(len(values)):
        ahead, left = values[i, 0] * step, values[i, 1] * step
        points[i, 0] = x + cosine * ahead - sine * left
        points[i, 1] = y + sine * ahead + cosine * left
        normals[i, 0], normals[i, 1] = 0.0, 0.0
        if values[i, 2] != _NO_SURFACE:
            direction = turn + values[i, 2] * (math.pi / _STEPS)
            normals[i, 0], normals[i, 1] = math.cos(direction), math.sin(direction)


def scan_surfaces(cloud: PointCloud) -> ScanSurfaces:
    """Return the surfaces of a scan in few bytes."""
    step = float(np.abs(cloud.points).max(initial=0.0)) / _STEPS or 1.0
    nx, ny = cloud.normals.T
    values = np.empty((cloud.count, 3), np.int16)
    values[:, :2] = np.rint(cloud.points / step)
    values[:, 2] = np.rint(np.arctan2(ny, nx) * (_STEPS / math.pi))
    values[(nx == 0.0) & (ny == 0.0), 2] = _NO_SURFACE
    return ScanSurfaces(values, step)


def scan_cloud(rays: Rays, farthest: float) -> PointCloud:
    """Return the surfaces that a scan shows, up to `farthest` [m]: thinned points with normals."""
    indices = np.flatnonzero(rays.ranges < farthest)
    if not indices.size:
        return NOTHING
    spacing = abs(float(rays.angles[-1] - rays.angles[0])) / max(1, len(rays.angles) - 1)
    scanner = rays.starts[len(rays.starts) // 2]
    return cloud_of(rays.points(farthest), indices, scanner, spacing).thinned()


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan of the map, or a pose from which landmarks were observed.

    Attributes:
        stamp_ns: time of the scan's first beam [ns].
        odometry: pose of the base in the odometry frame then.
        surfaces: those that it shows, in the frame of the base.
        rays: what it saw; None without a scan.
        submap: number of the submap that it belongs to.
        version: of the map when it was added; it does not count where the map was renewed later.

    """

    stamp_ns: int
    odometry: Pose
    surfaces: ScanSurfaces
    rays: ScanRays | None
    submap: int
    version: int = 0

    @property
    def cloud(self) -> PointCloud:
        """The points of its surfaces, in the frame of the base."""
        return self.surfaces.cloud()


@dataclass
class Submap:
    """Successive keyframes `first` to `last`: they see one place, and hardly drift."""

    number: int
    first: int
    last: int

    @property
    def middle(self) -> int:
        """Number of the keyframe whose frame is that of the submap."""
        return (self.first + self.last) // 2


def cloud_in(
    origin: Pose, members: list[int], keyframes: list[Keyframe], poses: Array
) -> PointCloud:
    """Return the points of some keyframes together, in the frame `origin`."""
    return placed_together(
        [(keyframes[k].surfaces, relative(origin, pose_of(poses, k))) for k in members]
    )


def pose_of(poses: Array, number: int) -> Pose:
    """Return one of the poses (n, 3)."""
    x, y, theta = poses[number].tolist()
    return x, y, theta


class PlaceIndex:
    """Finds the keyframes that saw the same surfaces: by cells of 0.5 m, and sides of walls."""

    def __init__(self) -> None:
        self._signatures: list[PointCloud] = []  # in the map
        self._cells: dict[tuple[int, int, int], list[int]] = defaultdict(list)

    def add(self, cloud: PointCloud, pose: Pose) -> None:
        """Add the next keyframe, at a pose in the map."""
        number = len(self._signatures)
        self._signatures.append(cloud.thinned(_PLACE).placed(pose))
        for key in self._keys(number):
            self._cells[key].append(number)

    def overlaps(self, number: int) -> list[tuple[float, int]]:
        """Return the keyframes that share surfaces with one, and which share of its, best first."""
        keys = self._keys(number)
        votes = Counter(chain.from_iterable(self._cells.get(key, ()) for key in keys))
        del votes[number]
        found = sorted((-count, other) for other, count in votes.items())
        return [(-count / len(keys), other) for count, other in found]

    def _keys(self, number: int) -> set[tuple[int, int, int]]:
        cloud = self._signatures[number]
        cells = np.floor(cloud.points / _PLACE).astype(int)
        nx, ny = cloud.normals[:, 0], cloud.normals[:, 1]
        side = np.where(np.abs(nx) > np.abs(ny), nx > 0, 2 + (ny > 0))
        side = np.where((nx == 0) & (ny == 0), 4, side)
        return set(zip(cells[:, 0].tolist(), cells[:, 1].tolist(), side.tolist(), strict=True))
