"""Loop closures: recognizes that the robot is in a place where it was before.

The points of a submap are searched for in those of earlier ones, in the window in which they may
lie after the drift in between. A match is accepted only if it is unambiguous, if the surfaces agree
after an exact alignment, and if neither of the two sees through a wall of the other.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Alignment, Reference
from cairn.components.slam.correlation import CorrelationMap, Peak
from cairn.components.slam.keyframes import DENSE_M, Keyframe, Submap
from cairn.components.slam.point_cloud import PointCloud, joined
from cairn.components.slam.pose_graph import Edge, EdgeKind, PoseGraph
from cairn.components.slam.submap_view import REACH_M, SubmapView, conflicts, view_of
from cairn.planar.poses import apart, compose, distance, relative

Array = NDArray[np.float64]

# The points that are searched for: one per cell of this size [m], and at least so many.
_SEARCH_CELL, _LEAST_POINTS = 0.1, 50
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
# Peaks of a search that are aligned exactly; those of more are ambiguous. The alignment that fits
# best must fit so much better than those that end elsewhere [m], [rad].
_MOST_PEAKS, _CLEARLY_BETTER, _SAME_M, _SAME_RAD = 12, 0.03, 0.3, 0.1
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
        self._views: list[SubmapView] = []
        self._firsts: list[int] = []  # the first keyframe of each submap

    @property
    def pending(self) -> int:
        """Number of comparisons that are planned."""
        return len(self._tasks)

    def add(self, submaps: list[Submap], keyframes: list[Keyframe], graph: PoseGraph) -> None:
        """Plan the comparisons of the last submap, which is complete, with those before it."""
        new = submaps[-1]
        number = new.number
        self._firsts.append(new.first)
        self._views.append(view_of(new, keyframes, graph.poses))
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

    def work(self, most: int, submaps: list[Submap], graph: PoseGraph) -> list[Edge]:
        """Compare at most `most` pairs of submaps; return the accepted closures."""
        accepted: list[Edge] = []
        done = 0
        while self._tasks and done < most:
            task = self._tasks.pop(0)
            if self._found.get(task.new, 0) >= _ENOUGH:
                continue
            done += 1
            self.counts.searched += 1
            edge = self._compare(task, submaps, graph)
            if edge is None:
                continue
            accepted += self._confirm(edge, task, graph)
        for edge in accepted:
            number = bisect_right(self._firsts, edge.second) - 1
            self._found[number] = self._found.get(number, 0) + 1
        self.counts.accepted += len(accepted)
        return accepted

    def _compare(self, task: Task, submaps: list[Submap], graph: PoseGraph) -> Edge | None:
        new, old = submaps[task.new], submaps[task.old]
        base, at = graph.pose(old.middle), graph.pose(new.middle)
        view = self._views[task.new]
        query = view.nearby(REACH_M, _SEARCH_CELL)
        around = [
            (relative(base, graph.pose(other.middle)), self._views[other.number])
            for other in submaps[max(0, task.old - 1) : task.old + 2]
            if other.number < task.new
        ]
        cloud = joined([one.cloud.placed(pose) for pose, one in around]).thinned(DENSE_M)
        if min(query.count, cloud.count) < _LEAST_POINTS:
            self.counts.not_found += 1
            return None
        anywhere = task.turn >= math.pi
        least = _LEAST_SCORE_ANYWHERE if anywhere else _LEAST_SCORE
        center = (0.0, 0.0, 0.0) if anywhere else relative(base, at)
        peaks = CorrelationMap(cloud.points).search(
            query.points, center, task.reach, task.turn, least, _MOST_PEAKS
        )
        if not peaks:
            self.counts.not_found += 1
            return None
        found = self._only_alignment(peaks, query, cloud)
        if found is None:
            return None
        if (
            conflicts(query.placed(found.pose).points, around) > _MOST_CONFLICTS
            or conflicts(cloud.points, [(found.pose, view)]) > _MOST_CONFLICTS
        ):
            self.counts.conflicting += 1
            return None
        information = turned(_WORTH * found.information, found.pose[2])
        return Edge(EdgeKind.CLOSURE, old.middle, new.middle, found.pose, information)

    def _only_alignment(
        self, peaks: list[Peak], query: PointCloud, cloud: PointCloud
    ) -> Alignment | None:
        """Return the alignment at the peak that fits clearly better than all others."""
        prior = np.diag([0.3**-2, 0.3**-2, 0.2**-2])
        reference = Reference(cloud)
        aligned = [(peak, reference.align(query, peak.pose, prior, 0.3)) for peak in peaks]
        peak, best = max(aligned, key=lambda one: one[1].fit)
        if (
            best.paired < _LEAST_PAIRED
            or best.deviation > _MOST_DEVIATION
            or apart(best.pose, peak.pose, _MOVED_M, _MOVED_RAD)
        ):
            self.counts.misaligned += 1
            return None
        others = [
            other.fit for _, other in aligned if apart(best.pose, other.pose, _SAME_M, _SAME_RAD)
        ]
        if len(peaks) == _MOST_PEAKS or best.fit - max(others, default=0.0) < _CLEARLY_BETTER:
            self.counts.ambiguous += 1
            return None
        return best

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
