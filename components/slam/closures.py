"""Loop closures: recognizes that the robot is in a place where it was before.

The points of a submap are searched for in those of earlier ones, in the window in which they may
lie after the drift in between. A match is accepted only if it is unambiguous, if the surfaces agree
after an exact alignment, and if neither of the two sees through a wall of the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Reference
from cairn.components.slam.correlation import CorrelationMap
from cairn.components.slam.keyframes import DENSE_M, Keyframe, Submap, cloud_in
from cairn.components.slam.point_cloud import PointCloud
from cairn.components.slam.pose_graph import Edge, EdgeKind, PoseGraph
from cairn.planar.poses import Pose, apart, compose, distance, inverse, relative
from cairn.planar.scan_grid import ScanGrid

Array = NDArray[np.float64]

# The points that are searched for: one per cell of this size [m], no farther than this from the
# middle of the submap [m], and at least so many.
_SEARCH_CELL, _SEARCH_REACH_M, _LEAST_POINTS = 0.1, 15.0, 50
# Submaps whose middles are farther apart see different places [m], beyond the window.
_NEAR_M = 6.0
# The window is so many standard deviations of the drift, and this [m], [rad] more; at most this
# [m] on each side.
_SIGMAS, _EXTRA_M, _EXTRA_RAD, _WIDEST_M = 3.0, 0.3, math.radians(3.0), 15.0
# Least score of a match; higher where the whole map is searched.
_LEAST_SCORE, _LEAST_SCORE_ANYWHERE = 0.55, 0.6
# After the exact alignment: least share of paired points, largest deviation [m], and largest
# distance from where the search found them [m], [rad].
_LEAST_PAIRED, _MOST_DEVIATION, _MOVED_M, _MOVED_RAD = 0.6, 0.06, 0.4, 0.1
# Most points of one that lie where the other sees free space, as a share of those that it sees.
_MOST_CONFLICTS = 0.2
_CONFLICT_CELL, _PASSES = 0.1, 3  # [m], [1]
# Neighbors of the alignment's points share their errors: a closure counts as this much of one.
_WORTH = 0.2
# A match in a window wider than this [m] is accepted only with a second one that agrees with it up
# to this [m], [rad].
_SURE_WINDOW_M, _AGREE_M, _AGREE_RAD = 2.5, 0.5, 0.1
_REMEMBERED = 12  # matches that wait for a second one
# Submaps that are searched for a new one.
_MOST_CANDIDATES = 24
# Matches that are enough for one submap.
_ENOUGH = 3


@dataclass(frozen=True)
class Task:
    """Two submaps to compare: `new` is searched for in `old`, in the window by its drift."""

    new: int
    old: int
    reach: float
    turn: float


@dataclass
class ClosureCounts:
    """How many comparisons of submaps ended how."""

    searched: int = 0
    accepted: int = 0
    not_found: int = 0
    ambiguous: int = 0
    misaligned: int = 0
    conflicting: int = 0
    unconfirmed: int = 0


class LoopCloser:
    """Compares each new submap with the earlier ones, a few per call."""

    def __init__(self) -> None:
        self.counts = ClosureCounts()
        self._tasks: list[Task] = []
        self._waiting: list[Edge] = []
        self._found: dict[int, int] = {}

    @property
    def pending(self) -> int:
        """Number of comparisons that are planned."""
        return len(self._tasks)

    def add(self, number: int, submaps: list[Submap], graph: PoseGraph) -> None:
        """Plan the comparisons of a new submap."""
        new = submaps[number]
        at = graph.pose(new.middle)
        drift = graph.drift(new.middle)
        islands = graph.islands()
        planned: list[tuple[float, Task]] = []
        for old in submaps[:number]:
            if new.number - old.number < 2 and islands[new.middle] == islands[old.middle]:
                continue
            if islands[new.middle] != islands[old.middle]:
                planned.append((0.0, Task(number, old.number, _WIDEST_M, math.pi)))
                continue
            covariance = drift[old.middle]
            sd_m = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
            reach = min(_SIGMAS * sd_m + _EXTRA_M, _WIDEST_M)
            turn = min(_SIGMAS * math.sqrt(covariance[2, 2]) + _EXTRA_RAD, math.pi)
            apart_m = distance(at, graph.pose(old.middle))
            if apart_m < _NEAR_M + reach:
                planned.append((apart_m / reach, Task(number, old.number, reach, turn)))
        planned.sort(key=lambda one: (one[0], -one[1].old))
        self._tasks += [task for _, task in planned[:_MOST_CANDIDATES]]

    def work(
        self, most: int | None, keyframes: list[Keyframe], submaps: list[Submap], graph: PoseGraph
    ) -> list[Edge]:
        """Compare at most `most` pairs of submaps, or all; return the accepted closures."""
        accepted: list[Edge] = []
        done = 0
        while self._tasks and (most is None or done < most):
            task = self._tasks.pop(0)
            if self._found.get(task.new, 0) >= _ENOUGH:
                continue
            done += 1
            self.counts.searched += 1
            edge = self._compare(task, keyframes, submaps, graph)
            if edge is None:
                continue
            accepted += self._confirm(edge, task, graph)
        for edge in accepted:
            number = keyframes[edge.second].submap
            self._found[number] = self._found.get(number, 0) + 1
        self.counts.accepted += len(accepted)
        return accepted

    def _compare(
        self, task: Task, keyframes: list[Keyframe], submaps: list[Submap], graph: PoseGraph
    ) -> Edge | None:
        new, old = submaps[task.new], submaps[task.old]
        poses, base = graph.poses, graph.pose(old.middle)
        at = graph.pose(new.middle)
        members = list(range(new.first, new.last + 1))
        query = cloud_in(at, members, keyframes, poses).thinned(_SEARCH_CELL)
        near = np.hypot(query.points[:, 0], query.points[:, 1]) < _SEARCH_REACH_M
        query = PointCloud(query.points[near], query.normals[near])
        beside = [
            other
            for other in submaps[max(0, task.old - 1) : task.old + 2]
            if other.number < task.new
        ]
        around = [k for other in beside for k in range(other.first, other.last + 1)]
        cloud = cloud_in(base, around, keyframes, poses).thinned(DENSE_M)
        if min(query.count, cloud.count) < _LEAST_POINTS:
            self.counts.not_found += 1
            return None
        anywhere = task.turn >= math.pi
        least = _LEAST_SCORE_ANYWHERE if anywhere else _LEAST_SCORE
        center = (0.0, 0.0, 0.0) if anywhere else relative(base, at)
        peaks = CorrelationMap(cloud.points).search(
            query.points, center, task.reach, task.turn, least
        )
        if len(peaks) != 1:
            if peaks:
                self.counts.ambiguous += 1
            else:
                self.counts.not_found += 1
            return None
        prior = np.diag([0.3**-2, 0.3**-2, 0.2**-2])
        found = Reference(cloud).align(query, peaks[0].pose, prior, 0.3)
        if (
            found.paired < _LEAST_PAIRED
            or found.deviation > _MOST_DEVIATION
            or apart(found.pose, peaks[0].pose, _MOVED_M, _MOVED_RAD)
        ):
            self.counts.misaligned += 1
            return None
        frames = (base, at, found.pose)
        if _conflicts(frames, query, members, cloud, around, keyframes, poses) > _MOST_CONFLICTS:
            self.counts.conflicting += 1
            return None
        information = turned(_WORTH * found.information, found.pose[2])
        return Edge(EdgeKind.CLOSURE, old.middle, new.middle, found.pose, information)

    def _confirm(self, edge: Edge, task: Task, graph: PoseGraph) -> list[Edge]:
        """Return the closures that are certain now: this one, and others that waited for it."""
        if task.turn < math.pi and task.reach <= _SURE_WINDOW_M:
            return [edge]
        agreeing = [other for other in self._waiting if _agree(edge, other, graph)]
        if not agreeing:
            self.counts.unconfirmed += 1
            self._waiting = [*self._waiting, edge][-_REMEMBERED:]
            return []
        self.counts.unconfirmed -= len(agreeing)
        self._waiting = [other for other in self._waiting if other not in agreeing]
        return [*agreeing, edge]


def turned(information: Array, heading: float) -> Array:
    """Return an information (3, 3) in the frame of a pose with this heading."""
    cosine, sine = math.cos(heading), math.sin(heading)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    result: Array = rotation.T @ information @ rotation
    return result


def _agree(edge: Edge, other: Edge, graph: PoseGraph) -> bool:
    """Return whether two closures of different submaps put the robot in the same place."""
    if edge.second == other.second:
        return False
    old = relative(graph.pose(other.first), graph.pose(edge.first))
    new = relative(graph.pose(other.second), graph.pose(edge.second))
    by_other = compose(other.measured, new)
    by_edge = compose(old, edge.measured)
    return not apart(by_other, by_edge, _AGREE_M, _AGREE_RAD)


def _conflicts(
    frames: tuple[Pose, Pose, Pose],
    query: PointCloud,
    members: list[int],
    cloud: PointCloud,
    around: list[int],
    keyframes: list[Keyframe],
    poses: Array,
) -> float:
    """Return the share of points that lie where the other submap has seen free space.

    `frames` are those of the old and the new submap in the map, and that of the new in the old one.
    """
    base, at, found = frames
    shares = []
    for origin, seen, points in (
        (base, around, query.placed(found).points),
        (at, members, cloud.placed(inverse(found)).points),
    ):
        grid = ScanGrid(_CONFLICT_CELL, _SEARCH_REACH_M)
        for k in seen:
            rays = keyframes[k].rays
            if rays is not None:
                x, y, theta = poses[k].tolist()
                grid.add(relative(origin, (x, y, theta)), rays.rays())
        shares.append(grid.seen_through(points, _PASSES))
    return max(shares)
