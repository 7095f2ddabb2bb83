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

from cairn.components.slam.alignment import NEAREST_M, Alignment, Reference
from cairn.components.slam.correlation import CELL_M, REACH_M, CorrelationMap, Peak
from cairn.components.slam.keyframes import Keyframe, Submap, placed_together
from cairn.components.slam.point_cloud import PointCloud, joined
from cairn.components.slam.pose_graph import AGREES, Edge, EdgeKind, PoseGraph
from cairn.components.slam.submap_view import SubmapView, conflicts, view_of
from cairn.planar.poses import Pose, apart, compose, distance, inverse, relative, wrap

Array = NDArray[np.float64]

# At least so many points are searched for.
_LEAST_POINTS = 50
# Submaps whose middles are farther apart see different places [m], beyond the window.
_NEAR_M = 6.0
# Least score of a match; higher where the whole map is searched.
_LEAST_SCORE, _LEAST_SCORE_ANYWHERE = 0.55, 0.6
# After the exact alignment: least share of paired points, largest deviation [m], and largest
# distance from where the search found them [m], [rad].
_LEAST_PAIRED, _MOST_DEVIATION, _MOVED_M, _MOVED_RAD = 0.6, 0.06, 0.4, 0.1
# Most points of one that lie where the other sees free space, as a share of those that it sees.
_MOST_CONFLICTS = 0.2
# Peaks of a search that are aligned exactly; those of more are ambiguous. The alignment that fits
# best must fit so much better than those that end elsewhere [m], [rad].
_MOST_PEAKS, _CLEARLY_BETTER, _SAME_M, _SAME_RAD = 20, 0.04, 0.2, 0.1
# For this comparison, the distance at which a pair counts half is at least this [m], and so many
# times the deviation of the best alignment.
_SHARP_M, _SHARP_DEVIATIONS = 0.015, 1.5
# A submap is compared with so many before and after it, to see whether the surroundings repeat.
# They do if it fits elsewhere as well as in the old one, or worse by this; poses nearer than this
# to its own are itself [m], [rad].
_BESIDE, _REPEATED, _ITSELF_M, _ITSELF_RAD = 5, 0.1, 0.5, 0.3
_ITSELF: Pose = (0.0, 0.0, 0.0)
# Neighbors of the alignment's points share their errors: a closure counts as this much of one.
_WORTH = 0.2
# A match in a window wider than this [m] is accepted only with so many in all that agree with it up
# to this [m], [rad].
_SURE_WINDOW_M, _CONFIRMATIONS, _AGREE_M, _AGREE_RAD = 2.5, 2, 0.5, 0.1
# Submaps that confirm each other show surfaces in so many cells of this size [m] together, each
# side of a wall counted: more than one room or corner, which others may look like. Less is enough
# if it is this share of all that the other island shows.
_SURFACE_CELL, _LEAST_SURFACE, _MOST_OF_ISLAND = 0.5, 90, 0.7
# In a narrow window, so many cells are enough, alone or with others that agree: a pillar with a
# piece of a wall fits beside each pillar.
_LEAST_SURFACE_ALONE = 30
# A match says where the robot is if the position deviates by at most this in any direction [m]:
# along a wall without features it deviates more. Others are not counted as matches.
_COMPLETE_SD_M = 0.3
_REMEMBERED = 48  # matches that wait for others
# Submaps that are searched for a new one.
_MOST_CANDIDATES = 24
# Of other islands, one submap in each cell of this size [m] is searched. Of more cells than
# `_MOST_CANDIDATES`, half are the nearest ones, as by odometry, and half are others each time.
_PLACES_M = 5.0
# Matches that are enough for one submap.
_ENOUGH = 3


@dataclass(frozen=True)
class Task:
    """Two submaps to compare: `new` is searched for in `old`, in the window by its drift.

    `anywhere`: they are of different islands.
    """

    new: int
    old: int
    reach: float
    turn: float
    anywhere: bool = False

    @property
    def is_sure(self) -> bool:
        """Whether the window is so narrow that a match needs no confirmation."""
        return not self.anywhere and self.reach <= _SURE_WINDOW_M and self.turn < math.pi


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
    """A match that waits for others that agree; `is_sure`: it was found in a narrow window."""

    edge: Edge
    is_sure: bool


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
        if self._views[new.number].cloud.count < _LEAST_POINTS:
            return
        submaps = [one for one in submaps if self._views[one.number].cloud.count >= _LEAST_POINTS]
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
                if edge is not None and task.is_sure and self._is_distinctive(edge, graph):
                    accepted.append(edge)
                elif edge is not None:
                    self._waiting = [*self._waiting, _Match(edge, task.is_sure)][-_REMEMBERED:]
            if not any(other.new == task.new for other in self._tasks):
                accepted += self._confirmed(submaps, graph)
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
        if min(query.count, cloud.count) < _LEAST_POINTS:
            return None
        least = _LEAST_SCORE_ANYWHERE if task.anywhere else _LEAST_SCORE
        center = (0.0, 0.0, 0.0) if task.anywhere else relative(base, at)
        peaks = CorrelationMap(cloud.points).search(
            query.points, center, task.reach, task.turn, least, _MOST_PEAKS
        )
        if peaks and not task.anywhere:
            peaks.append(Peak(center, least))  # along a corridor it may be best
        if not peaks:
            return None
        found = self._only_alignment(peaks, query, cloud)
        if found is None:
            return None
        information = turned(_WORTH * found.information, found.pose[2])
        edge = Edge(EdgeKind.CLOSURE, old.middle, new.middle, found.pose, information)
        if not task.is_sure and (
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
        prior = np.diag([0.3**-2, 0.3**-2, 0.2**-2])
        reference = Reference(cloud)
        aligned = [(peak, reference.align(query, peak.pose, prior)) for peak in peaks]
        # Once more, with less tolerance: on a long wall, all places along it fit roughly.
        best_deviation = min(
            (one.deviation for _, one in aligned if one.paired >= _LEAST_PAIRED), default=math.inf
        )
        if best_deviation > _MOST_DEVIATION:
            self.counts.misaligned += 1
            return None
        sharp = max(_SHARP_M, _SHARP_DEVIATIONS * best_deviation)
        aligned = [
            (peak, reference.align(query, one.pose, prior, NEAREST_M, sharp))
            for peak, one in aligned
        ]
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
        if len(peaks) >= _MOST_PEAKS or best.fit - max(others, default=0.0) < _CLEARLY_BETTER:
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
            query.points, _ITSELF, task.reach, task.turn, _LEAST_SCORE, _MOST_PEAKS, 0.0
        )
        reference = Reference(cloud)
        prior = np.diag([0.3**-2, 0.3**-2, 0.2**-2])
        sharp = max(_SHARP_M, _SHARP_DEVIATIONS * found.deviation)
        for peak in peaks:
            rough = reference.align(query, peak.pose, prior)
            again = reference.align(query, rough.pose, prior, NEAREST_M, sharp)
            is_itself = not apart(again.pose, _ITSELF, _ITSELF_M, _ITSELF_RAD)
            if is_itself or again.fit < found.fit - _REPEATED:
                continue
            for shift in (again.pose, inverse(again.pose)):
                other = compose(found.pose, shift)
                dx, dy, turn = other[0] - center[0], other[1] - center[1], other[2] - center[2]
                if max(abs(dx), abs(dy)) <= task.reach and abs(wrap(turn)) <= task.turn:
                    return True
        return False

    def _is_distinctive(self, edge: Edge, graph: PoseGraph) -> bool:
        """Return whether a match in a narrow window needs no other one that agrees."""
        return self._surface(edge.second, {edge.second}, graph) >= _LEAST_SURFACE_ALONE

    def _surface(self, origin: int, middles: set[int], graph: PoseGraph) -> int:
        """Return how many cells of surfaces some submaps, given by their middles, show together."""
        base = graph.pose(origin)
        clouds = [
            self._views[bisect_right(self._firsts, middle) - 1]
            .nearby(REACH_M, CELL_M)
            .placed(relative(base, graph.pose(middle)))
            for middle in sorted(middles)
        ]
        return joined(clouds).thinned(_SURFACE_CELL).count

    def _shows_enough(self, matches: list[_Match], submaps: list[Submap], graph: PoseGraph) -> bool:
        """Return whether matches that agree show too much for a coincidence."""
        edge = matches[0].edge
        shown = self._surface(edge.second, {one.edge.second for one in matches}, graph)
        if all(one.is_sure for one in matches):
            return shown >= _LEAST_SURFACE_ALONE
        islands = graph.islands()
        if shown >= _LEAST_SURFACE or islands[edge.first] == islands[edge.second]:
            return shown >= _LEAST_SURFACE
        others = submaps[: len(self._views)]
        island = {one.middle for one in others if islands[one.middle] == islands[edge.first]}
        return shown >= _MOST_OF_ISLAND * self._surface(edge.first, island, graph)

    def _confirmed(self, submaps: list[Submap], graph: PoseGraph) -> list[Edge]:
        """Return the closures that others confirm, of those that need it.

        They put at least two submaps in the same place, and twice as many as any other place of
        these submaps.
        """
        islands = graph.islands()
        agreeing = [
            [other for other in self._waiting if _agree(one.edge, other.edge, islands, graph)]
            for one in self._waiting
        ]
        support = [{one.edge.second for one in matches} for matches in agreeing]
        for k in sorted(range(len(support)), key=lambda k: -len(support[k])):
            if len(support[k]) < _CONFIRMATIONS:
                break
            rivals = [
                len(support[i])
                for i, other in enumerate(self._waiting)
                if other.edge.second in support[k]
                and not _agree(self._waiting[k].edge, other.edge, islands, graph)
            ]
            is_rivaled = 2 * max(rivals, default=0) > len(support[k])
            if is_rivaled or not self._shows_enough(agreeing[k], submaps, graph):
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
        if apart_m < _NEAR_M + reach:
            planned.append((apart_m / reach, Task(new.number, old.number, reach, turn)))
    planned.sort(key=lambda one: (one[0], -one[1].old))
    return [task for _, task in planned[:_MOST_CANDIDATES]]


def _anywhere_tasks(
    new: Submap, olds: list[Submap], islands: NDArray[np.int64], graph: PoseGraph
) -> list[Task]:
    """Return the comparisons with submaps of other islands: one for each place, nearest first."""
    at = graph.pose(new.middle)
    by_cell: dict[tuple[int, int, int], Submap] = {}
    for old in olds:
        x, y, _ = graph.pose(old.middle)
        cell = int(islands[old.middle]), math.floor(x / _PLACES_M), math.floor(y / _PLACES_M)
        by_cell[cell] = old
    places = sorted(by_cell.values(), key=lambda old: distance(graph.pose(old.middle), at))
    half = _MOST_CANDIDATES // 2
    if len(places) > _MOST_CANDIDATES:
        others = places[half:]
        first = new.number * half % len(others)
        places = places[:half] + (others + others)[first : first + half]
    return [Task(new.number, old.number, REACH_M, math.pi, True) for old in places]


def turned(matrix: Array, heading: float) -> Array:
    """Return an information or covariance (3, 3) in the frame of a pose with this heading."""
    cosine, sine = math.cos(heading), math.sin(heading)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    result: Array = rotation.T @ matrix @ rotation
    return result


def _is_complete(edge: Edge) -> bool:
    """Return whether a match shows the position in all directions."""
    covariance = np.linalg.inv(edge.information)
    return bool(np.linalg.eigvalsh(covariance[:2, :2])[-1] < _COMPLETE_SD_M**2)


def _agree(edge: Edge, other: Edge, islands: NDArray[np.int64], graph: PoseGraph) -> bool:
    """Return whether two closures put the robot in the same place."""
    if islands[edge.first] != islands[other.first] or islands[edge.second] != islands[other.second]:
        return False
    old = relative(graph.pose(other.first), graph.pose(edge.first))
    new = relative(graph.pose(other.second), graph.pose(edge.second))
    by_other = compose(other.measured, new)
    by_edge = compose(old, edge.measured)
    return not apart(by_other, by_edge, _AGREE_M, _AGREE_RAD)
