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

from cairn.components.slam.alignment import NEAREST_M, NOISE_M, Alignment, Reference
from cairn.components.slam.correlation import CELL_M, REACH_M, CorrelationMap, Peak
from cairn.components.slam.keyframes import Keyframe, Submap, placed_together
from cairn.components.slam.point_cloud import PointCloud, joined
from cairn.components.slam.pose_graph import AGREES, Edge, EdgeKind, PoseGraph, turned
from cairn.components.slam.submap_view import SubmapView, conflicts, view_of
from cairn.planar.poses import Pose, apart, compose, distance, inverse, relative, wrap

Array = NDArray[np.float64]

# Submaps whose middles are nearer than this [m] show the same place. In a window of this size, a
# match needs not show the position in all directions. Of other islands, one submap for each area of
# this size is searched.
_PLACE_M = 6.0
# Least share of points that match.
_LEAST_PAIRED = 0.55
# Most points of one that lie where the other sees free space, as a share of those that it sees.
_MOST_CONFLICTS = 0.2
# Poses that differ by less are the same [m], [rad].
_SAME_M, _SAME_RAD = 0.3, 0.1
# A submap is compared with so many before and after it, to see whether the surroundings repeat.
_BESIDE = 5
_ITSELF: Pose = (0.0, 0.0, 0.0)
# They do if it fits elsewhere as well as in the old one, or worse by this.
_REPEATED = 0.1
# Neighbors of the alignment's points share their errors: a closure counts as this much of one.
_WORTH = 0.2
# A match is not a coincidence if the submaps that agree show surfaces, each side of a wall counted,
# in so many cells of this size [m] for each bit of information: the logarithm of the number of
# poses among which it was found. A pillar with a piece of a wall fits beside each pillar.
_CELLS_PER_BIT, _SURFACE_CELL = 4, 0.5
# Submaps that are searched for a new one, and peaks of a search that are aligned exactly: of more,
# all are ambiguous. Of more places of other islands, half are the nearest ones, as by odometry,
# and half are others each time. Twice as many matches wait for others.
_MOST = 24
# Matches that are enough for one submap.
_ENOUGH = 3


@dataclass(frozen=True)
class Task:
    """Two submaps to compare: `new` is searched for in `old`, in the window by its drift.

    `anywhere`: they are of different islands; then it may be in any of so many places.
    """

    new: int
    old: int
    reach: float
    turn: float
    anywhere: int = 0

    @property
    def is_narrow(self) -> bool:
        """Whether the window is of one place."""
        return not self.anywhere and 2 * self.reach <= _PLACE_M and self.turn < math.pi

    @property
    def bits(self) -> float:
        """The binary logarithm of the number of poses in the window, or in all places."""
        side = _PLACE_M if self.anywhere else 2 * self.reach
        steps, turns = 1 + side / _SAME_M, 1 + 2 * self.turn / _SAME_RAD
        return math.log2(steps**2 * turns * max(1, self.anywhere))


@dataclass
class ClosureCounts:
    """How many comparisons of submaps ended how."""

    accepted: int = 0
    ambiguous: int = 0
    misaligned: int = 0
    conflicting: int = 0
    unconfirmed: int = 0


@dataclass(frozen=True)
class _Match:
    """A match that waits for others that agree, and the information that it takes in bits."""

    edge: Edge
    bits: float


class LoopCloser:
    """Compares each new submap with the earlier ones, a few per call."""

    def __init__(self) -> None:
        self.counts = ClosureCounts()
        self._tasks: list[Task] = []
        self._waiting: list[_Match] = []
        self._found: dict[int, int] = {}
        self._views: list[SubmapView] = []
        self._firsts: list[int] = []  # the first keyframe of each submap
        self._islands = np.zeros(0, np.int64)  # of the keyframes when the last submap was added

    @property
    def pending(self) -> int:
        """Number of comparisons that are planned."""
        return len(self._tasks)

    def add(self, submaps: list[Submap], keyframes: list[Keyframe], graph: PoseGraph) -> None:
        """Plan the comparisons of the last submap, which is complete, with those before it."""
        new = submaps[-1]
        for submap in submaps[len(self._views) :]:  # several, if the map was read from a file
            self._firsts.append(submap.first)
            self._views.append(view_of(submap, keyframes, graph.poses))
        islands = self._islands = graph.islands()
        if not self._views[new.number].surfaces.count:
            return
        submaps = [one for one in submaps if self._views[one.number].surfaces.count]
        here = [old for old in submaps[:-2] if islands[old.middle] == islands[new.middle]]
        elsewhere = [old for old in submaps[:-1] if islands[old.middle] != islands[new.middle]]
        # A place in the own island is more urgent than those where the robot may have been.
        self._tasks = [task for task in self._tasks if not task.anywhere] + [
            *_near_tasks(new, here, graph),
            *(task for task in self._tasks if task.anywhere),
            *_anywhere_tasks(new, elsewhere, islands, graph),
        ]

    def work(self, most: int, submaps: list[Submap], graph: PoseGraph) -> list[Edge]:
        """Compare at most `most` pairs of submaps; return the accepted closures."""
        accepted: list[Edge] = []
        done = 0
        while self._tasks and done < most and not accepted:
            task = self._tasks.pop(0)
            is_needed = self._found.get(task.new, 0) < _ENOUGH
            if is_needed and task.anywhere:
                islands = graph.islands()
                is_needed = islands[submaps[task.new].middle] != islands[submaps[task.old].middle]
            if is_needed:
                done += 1
                edge = self._compare(task, submaps, graph)
                if edge is not None:
                    self._waiting = [*self._waiting, _Match(edge, task.bits)][-2 * _MOST :]
            if task.is_narrow or not any(other.new == task.new for other in self._tasks):
                accepted += self._confirmed(graph)
        for edge in accepted:
            if not _is_complete(edge):
                continue
            number = bisect_right(self._firsts, edge.second) - 1
            self._found[number] = self._found.get(number, 0) + 1
        self.counts.accepted += len(accepted)
        self.counts.unconfirmed = len(self._waiting)
        return accepted

    def _compare(self, task: Task, submaps: list[Submap], graph: PoseGraph) -> Edge | None:
        new, old = submaps[task.new], submaps[task.old]
        base, at = graph.pose(old.middle), graph.pose(new.middle)
        view = self._views[task.new]
        query = view.nearby(REACH_M, CELL_M)
        around = [
            (relative(base, graph.pose(other.middle)), self._views[other.number])
            for other in submaps[max(0, task.old - 1) : task.old + 2]
            if other.number < task.new and self._islands[other.middle] == self._islands[old.middle]
        ]
        cloud = placed_together([(one.surfaces, pose) for pose, one in around]).thinned()
        if not min(query.count, cloud.count):
            return None
        center = (0.0, 0.0, 0.0) if task.anywhere else relative(base, at)
        peaks = CorrelationMap(cloud.points).search(
            query.points, center, task.reach, task.turn, _LEAST_PAIRED, _MOST
        )
        if peaks and not task.anywhere:
            peaks.append(Peak(center, _LEAST_PAIRED))  # along a corridor it may be best
        if not peaks:
            return None
        found = self._only_alignment(peaks, query, cloud)
        if found is None:
            return None
        information = turned(_WORTH * found.information, found.pose[2])
        edge = Edge(EdgeKind.CLOSURE, old.middle, new.middle, found.pose, information)
        if not task.is_narrow and (
            not _is_complete(edge) or self._is_repeated(task, found, center, submaps, graph)
        ):
            self.counts.ambiguous += 1
            return None
        if (
            conflicts(query.placed(found.pose).points, around) > _MOST_CONFLICTS
            or conflicts(cloud.points, [(found.pose, view)]) > _MOST_CONFLICTS
        ):
            self.counts.conflicting += 1
            return None
        return edge

    def _only_alignment(
        self, peaks: list[Peak], query: PointCloud, cloud: PointCloud
    ) -> Alignment | None:
        """Return the alignment at the peak that fits clearly better than all others."""
        aligned = _aligned(peaks, query, cloud)
        best = max(aligned, key=lambda one: one.fit)
        if best.paired < _LEAST_PAIRED or not _are_same(best.pose, peaks[aligned.index(best)].pose):
            self.counts.misaligned += 1
            return None
        others = [one for one in aligned if not _are_same(best.pose, one.pose)]
        if len(peaks) >= _MOST or any(_is_as_likely(one, best) for one in others):
            self.counts.ambiguous += 1
            return None
        return best

    def _is_repeated(
        self, task: Task, found: Alignment, center: Pose, submaps: list[Submap], graph: PoseGraph
    ) -> bool:
        """Return whether the surroundings repeat so that other poses in the window are as likely.

        A corridor with equal doors at equal distances looks the same from several places, of which
        the old submap may show only one.
        """
        new = submaps[task.new]
        at, island = graph.pose(new.middle), graph.islands()
        around = [
            (self._views[other.number].surfaces, relative(at, graph.pose(other.middle)))
            for other in submaps[max(0, task.new - _BESIDE) : task.new + _BESIDE + 1]
            if island[other.middle] == island[new.middle] and other.number < len(self._views)
        ]
        query = self._views[task.new].nearby(REACH_M, CELL_M)
        cloud = placed_together(around).thinned()
        peaks = CorrelationMap(cloud.points).search(
            query.points, _ITSELF, task.reach, task.turn, _LEAST_PAIRED, _MOST, 0.0
        )
        for again in _aligned(peaks, query, cloud, found.deviation):
            if _are_same(again.pose, _ITSELF) or again.fit < found.fit - _REPEATED:
                continue
            for shift in (again.pose, inverse(again.pose)):
                other = compose(found.pose, shift)
                dx, dy, turn = other[0] - center[0], other[1] - center[1], other[2] - center[2]
                if max(abs(dx), abs(dy)) <= task.reach and abs(wrap(turn)) <= task.turn:
                    return True
        return False

    def _shows_enough(self, matches: list[_Match], graph: PoseGraph) -> bool:
        """Return whether the submaps of matches that agree show too much for a coincidence."""
        middles = sorted({one.edge.second for one in matches})
        base = graph.pose(middles[0])
        clouds = [
            self._views[bisect_right(self._firsts, middle) - 1]
            .nearby(REACH_M, CELL_M)
            .placed(relative(base, graph.pose(middle)))
            for middle in middles
        ]
        shown = joined(clouds).thinned(_SURFACE_CELL).count
        return shown >= _CELLS_PER_BIT * min(one.bits for one in matches)

    def _confirmed(self, graph: PoseGraph) -> list[Edge]:
        """Return the closures that agree, and show too much for a coincidence.

        They put twice as many submaps in the same place as in any other one.
        """
        islands = graph.islands()
        agreeing = [
            [other for other in self._waiting if _agree(one.edge, other.edge, islands, graph)]
            for one in self._waiting
        ]
        support = [{one.edge.second for one in matches} for matches in agreeing]
        for k in sorted(range(len(support)), key=lambda k: -len(support[k])):
            rivals = [
                len(support[i])
                for i, other in enumerate(self._waiting)
                if other.edge.second in support[k]
                and not _agree(self._waiting[k].edge, other.edge, islands, graph)
            ]
            is_rivaled = 2 * max(rivals, default=0) > len(support[k])
            if is_rivaled or not self._shows_enough(agreeing[k], graph):
                continue
            self._waiting = [one for one in self._waiting if one.edge.second not in support[k]]
            return [one.edge for one in agreeing[k]]
        return []


def _near_tasks(new: Submap, olds: list[Submap], graph: PoseGraph) -> list[Task]:
    """Return the comparisons with submaps that may show the same place, best first."""
    at, drift = graph.pose(new.middle), graph.drift(new.middle)
    planned: list[tuple[float, Task]] = []
    for old in olds:
        covariance = drift[old.middle]
        sd_m = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
        reach = min(AGREES * sd_m, REACH_M)
        turn = min(AGREES * math.sqrt(covariance[2, 2]), math.pi)
        apart_m = distance(at, graph.pose(old.middle))
        if apart_m < _PLACE_M + reach:
            planned.append((apart_m / reach, Task(new.number, old.number, reach, turn)))
    planned.sort(key=lambda one: (one[0], -one[1].old))
    return [task for _, task in planned[:_MOST]]


def _anywhere_tasks(
    new: Submap, olds: list[Submap], islands: NDArray[np.int64], graph: PoseGraph
) -> list[Task]:
    """Return the comparisons with submaps of other islands: one for each place, nearest first."""
    at = graph.pose(new.middle)
    by_cell: dict[tuple[int, int, int], Submap] = {}
    for old in olds:
        x, y, _ = graph.pose(old.middle)
        cell = int(islands[old.middle]), math.floor(x / _PLACE_M), math.floor(y / _PLACE_M)
        by_cell[cell] = old
    places = sorted(by_cell.values(), key=lambda old: distance(graph.pose(old.middle), at))
    count, half = len(places), _MOST // 2
    if count > _MOST:
        others = places[half:]
        first = new.number * half % len(others)
        places = places[:half] + (others + others)[first : first + half]
    return [Task(new.number, old.number, REACH_M, math.pi, count) for old in places]


def _is_complete(edge: Edge) -> bool:
    """Return whether a match shows the position in all directions."""
    covariance = np.linalg.inv(edge.information)
    return bool(np.linalg.eigvalsh(covariance[:2, :2])[-1] < _SAME_M**2)


def _aligned(
    peaks: list[Peak], query: PointCloud, cloud: PointCloud, deviation: float = 0.0
) -> list[Alignment]:
    """Return the exact alignment at each peak, for a deviation, or the least one of them."""
    prior, reference = np.diag([0.3**-2, 0.3**-2, 0.2**-2]), Reference(cloud)
    rough = [reference.align(query, peak.pose, prior) for peak in peaks]
    # Once more, with less tolerance: on a long wall, all places along it fit roughly.
    sharp = max(NOISE_M, deviation or min(one.deviation for one in rough))
    return [reference.align(query, one.pose, prior, NEAREST_M, sharp) for one in rough]


def _are_same(pose: Pose, other: Pose) -> bool:
    """Return whether two poses are the same one."""
    return not apart(pose, other, _SAME_M, _SAME_RAD)


def _is_as_likely(other: Alignment, best: Alignment) -> bool:
    """Return whether the points do not clearly lie in the best pose instead of another one."""
    return best.log_likelihood - other.log_likelihood < 0.5 * AGREES**2


def _agree(edge: Edge, other: Edge, islands: NDArray[np.int64], graph: PoseGraph) -> bool:
    """Return whether two closures put the robot in the same place."""
    if islands[edge.first] != islands[other.first] or islands[edge.second] != islands[other.second]:
        return False
    old = relative(graph.pose(other.first), graph.pose(edge.first))
    new = relative(graph.pose(other.second), graph.pose(edge.second))
    by_other = compose(other.measured, new)
    by_edge = compose(old, edge.measured)
    return _are_same(by_other, by_edge)
