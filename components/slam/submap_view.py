"""What a submap shows: the surfaces that stand still, and the space that is free."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.correlation import CELL_M, REACH_M
from cairn.components.slam.keyframes import (
    Keyframe,
    ScanSurfaces,
    Submap,
    placed_together,
    pose_of,
    scan_surfaces,
)
from cairn.components.slam.point_cloud import PointCloud
from cairn.planar.grid import Frame
from cairn.planar.poses import Pose, inverse, relative
from cairn.planar.scan_grid import NOT_SEEN, OCCUPIED_SHARE, SEEN_FREE, ScanGrid

Array = NDArray[np.float64]

# Rays that must have passed a cell that is free.
_PASSES = 3


@dataclass(frozen=True)
class SubmapView:
    """What a submap shows, in the frame of its middle keyframe.

    Attributes:
        surfaces: those that stand still.
        packed_evidence: what was seen of each cell of 0.1 m, and which are free, compressed: see
            `ScanGrid.evidence`.
        shape: rows and columns of these cells.
        frame: of the cells.

    """

    surfaces: ScanSurfaces
    packed_evidence: bytes
    shape: tuple[int, int]
    frame: Frame

    def nearby(self, reach: float, cell: float) -> PointCloud:
        """Return the surfaces up to `reach` [m] from the origin, one point per `cell` [m]."""
        cloud = self.surfaces.cloud().thinned(cell)
        near = np.hypot(cloud.points[:, 0], cloud.points[:, 1]) < reach
        return PointCloud(cloud.points[near], cloud.normals[near])

    def evidence(self, points: Array) -> NDArray[np.uint8]:
        """Return what was seen of the cell of each point (n, 2) [m]."""
        x, y, _ = self.frame.origin
        cells = np.floor((points - (x, y)) / self.frame.resolution).astype(np.int64)
        rows, columns = self.shape
        inside = (cells >= 0).all(axis=1) & (cells[:, 1] < rows) & (cells[:, 0] < columns)
        found = np.full(len(points), NOT_SEEN, np.uint8)
        if inside.any():
            values = np.frombuffer(zlib.decompress(self.packed_evidence), np.uint8)
            found[inside] = values.reshape(self.shape)[cells[inside, 1], cells[inside, 0]]
        return found


def view_of(submap: Submap, keyframes: Sequence[Keyframe], poses: Array) -> SubmapView:
    """Return what a submap shows, from the poses (n, 3) of the keyframes."""
    origin = pose_of(poses, submap.middle)
    grid = ScanGrid(CELL_M, REACH_M)
    placed = []
    for number in range(submap.first, submap.last + 1):
        at, frame = relative(origin, pose_of(poses, number)), keyframes[number]
        if frame.rays is not None:
            grid.add(at, frame.rays.rays())
        placed.append((frame.surfaces, at))
    cloud = placed_together(placed)
    # Beams pass where a person was before or after.
    stands = grid.ended_share(cloud.points) >= OCCUPIED_SHARE
    cloud = PointCloud(cloud.points[stands], cloud.normals[stands])
    evidence = grid.evidence(_PASSES)
    return SubmapView(
        scan_surfaces(cloud.thinned()),
        zlib.compress(evidence.values.tobytes(), zlib.Z_BEST_SPEED),
        evidence.values.shape,
        evidence.frame,
    )


def conflicts(points: Array, views: Sequence[tuple[Pose, SubmapView]]) -> float:
    """Return the share of points (n, 2) [m] that lie where others have seen free space.

    `views` are the others, with their poses in the points' frame. Points that none of them has seen
    are left out; 0 without others.
    """
    seen = np.zeros(len(points), np.bool_)
    free, solid = seen.copy(), seen.copy()
    for pose, view in views:
        evidence = view.evidence(PointCloud(points, points).placed(inverse(pose)).points)
        seen |= evidence != NOT_SEEN
        free |= evidence == SEEN_FREE
        solid |= (evidence != NOT_SEEN) & (evidence != SEEN_FREE)
    through = free & ~solid
    known = int(np.count_nonzero(seen))
    return int(np.count_nonzero(through)) / known if known else 0.0
