"""What the last keyframes show: the surfaces that stand still, and the space that is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.keyframes import DENSE_M, Keyframe
from cairn.components.slam.point_cloud import PointCloud, joined
from cairn.planar.poses import Pose, apart, inverse
from cairn.planar.scan_grid import NOT_SEEN, SEEN_FREE, ScanGrid
from cairn.planar.scans import Rays

Array = NDArray[np.float64]

# Size of the cells in which space is free [m], how far rays show it [m], and how many of them must
# have passed a cell.
_CELL, _REACH_M, _PASSES = 0.1, 15.0, 3
# A point does not stand still if a smaller share of the rays ended around it.
_STANDING_SHARE = 0.25
# A keyframe is drawn again if its pose has changed by more than this [m], [rad].
_MOVED_M, _MOVED_RAD = 0.03, 0.01
# The grid, which only grows, is replaced after so many keyframes.
_RENEWED = 100
# A beam that ends so far behind a surface has passed it [m]; one that ends so near has seen it.
_BEHIND_M, _SEEN_M = 0.4, 0.2
# Least points of surfaces, 4 cm apart, of which a share is known.
_LEAST_COMPARED = 60
# A surface is compared with the beam toward it if it faces the scanner by this cosine.
_FACING = 0.3


@dataclass(frozen=True)
class _Drawn:
    number: int
    pose: Pose
    rays: Rays
    cloud: PointCloud  # what stands still, in the frame of the base


class RecentSurfaces:
    """The surfaces and the free space that the last keyframes have seen, in the map.

    What appears where space was free moves, as people do; the surfaces do not include it.
    """

    def __init__(self) -> None:
        self._grid = ScanGrid(_CELL, _REACH_M)
        self._drawn: dict[int, _Drawn] = {}
        self._added = 0
        self.cloud = PointCloud(np.zeros((0, 2)), np.zeros((0, 2)))
        """The surfaces that stand still."""

    def show(self, numbers: Sequence[int], keyframes: Sequence[Keyframe], poses: Array) -> None:
        """Show these keyframes, in the order of their times, at their poses (n, 3) in the map."""
        if self._added > _RENEWED:
            self._grid, self._added = ScanGrid(_CELL, _REACH_M), 0
            for drawn in self._drawn.values():
                self._grid.add(drawn.pose, drawn.rays)
        shown = set(numbers)
        for number in [number for number in self._drawn if number not in shown]:
            old = self._drawn.pop(number)
            self._grid.remove(old.pose, old.rays)
        for number in numbers:
            self._draw(number, keyframes[number], _pose(poses, number))
        clouds = [self._drawn[k].cloud.placed(_pose(poses, k)) for k in numbers if k in self._drawn]
        cloud = joined(clouds)
        stands = self._grid.ended_share(cloud.points) >= _STANDING_SHARE
        self.cloud = PointCloud(cloud.points[stands], cloud.normals[stands]).thinned(DENSE_M)

    def _draw(self, number: int, frame: Keyframe, pose: Pose) -> None:
        old = self._drawn.get(number)
        if frame.rays is None or (
            old is not None and not apart(old.pose, pose, _MOVED_M, _MOVED_RAD)
        ):
            return
        if old is not None:
            self._grid.remove(old.pose, old.rays)
            rays, cloud = old.rays, old.cloud
        else:
            rays = frame.rays.rays()
            stands = ~self.moving(frame.cloud.placed(pose).points)
            cloud = PointCloud(frame.cloud.points[stands], frame.cloud.normals[stands])
            self._added += 1
        self._grid.add(pose, rays)
        self._drawn[number] = _Drawn(number, pose, rays, cloud)

    def moving(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (n, 2) [m] lie where space was free."""
        free: NDArray[np.bool_] = self._grid.evidence_at(points, _PASSES) == SEEN_FREE
        return free

    def known(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (n, 2) [m] lie where the keyframes have seen anything."""
        seen: NDArray[np.bool_] = self._grid.evidence_at(points, _PASSES) != NOT_SEEN
        return seen

    def passed_share(self, pose: Pose, rays: Rays) -> float:
        """Return which share of the surfaces that a scan from a pose reaches its beams pass.

        People before the scanner hide surfaces, but only a robot that is elsewhere sees through
        them. 0 if the scan reaches hardly any.
        """
        cloud = self.cloud.placed(inverse(pose))
        offset = cloud.points - rays.starts[len(rays.starts) // 2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        facing = -(offset * cloud.normals).sum(axis=1) > _FACING * distance
        offset, distance = offset[facing], distance[facing]
        first, last = float(rays.angles[0]), float(rays.angles[-1])
        if first == last or not len(distance):
            return 0.0
        spacing = (last - first) / (len(rays.angles) - 1)
        turn = np.arctan2(offset[:, 1], offset[:, 0]) - first
        turn = np.mod(turn * np.sign(spacing), 2 * np.pi)
        beams = np.rint(turn / abs(spacing)).astype(np.int64)
        inside = beams < len(rays.ranges)
        beyond = rays.ranges[beams[inside]] - distance[inside]
        # Beams without an end say nothing: dark surfaces and glass return none.
        passed = int(np.count_nonzero(np.isfinite(beyond) & (beyond > _BEHIND_M)))
        seen = int(np.count_nonzero(np.abs(beyond) < _SEEN_M))
        return passed / (passed + seen) if passed + seen >= _LEAST_COMPARED else 0.0


def _pose(poses: Array, number: int) -> Pose:
    x, y, theta = poses[number].tolist()
    return x, y, theta
