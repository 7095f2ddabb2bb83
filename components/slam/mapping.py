"""Mapping: makes keyframes and submaps of scans, and keeps the pose graph consistent."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Reference
from cairn.components.slam.closures import LoopCloser, turned
from cairn.components.slam.keyframes import (
    DENSE_M,
    Keyframe,
    PlaceIndex,
    Submap,
    cloud_in,
    scan_cloud,
    scan_rays,
)
from cairn.components.slam.pose_graph import Edge, EdgeKind, PoseGraph
from cairn.components.slam.tracking import ScanTracker, Tracked
from cairn.planar.poses import Pose, apart, compose, relative
from cairn.planar.scans import Rays

Array = NDArray[np.float64]

# A keyframe is made after so much motion [m], [rad].
_KEYFRAME_M, _KEYFRAME_RAD = 0.2, 0.2
# Scans are aligned to so many keyframes before them.
_SURROUNDINGS = 30
# A submap ends after so much motion [m], and after so many keyframes.
_SUBMAP_M, _SUBMAP_KEYFRAMES = 4.0, 40
# Pairs of submaps that are compared while a keyframe is added: about 10 ms each.
_COMPARED = 2
# The graph is optimized once per so many new keyframes: the number of all divided by this. It takes
# 0.5 s with 6,000 keyframes, which are then added in 6 to 15 s of driving.
_KEYFRAMES_PER_PAUSE = 200
# When the map is finished: keyframes that share this much of what they see are aligned again, with
# this many around the partner on each side; so many partners, no nearer to each other and to the
# keyframe than this.
_SHARED, _BESIDE, _PARTNERS, _BETWEEN = 0.35, 2, 6, 4
# Points are paired up to this distance [m] in the first and in later rounds.
_REACH_M = (0.3, 0.15)
# An alignment to a partner may move a keyframe by this much [m], [rad], and must pair as many
# points, with at most this deviation [m].
_MOVED_M, _MOVED_RAD, _LEAST_PAIRED, _MOST_DEVIATION = 0.3, 0.1, 0.2, 0.05

Progress = Callable[[str, float], None]
"""Called with the name of a stage and its completed share, from 0 to 1."""


@dataclass(frozen=True)
class Step:
    """A scan of the trajectory: its time [ns], the keyframe before it, and the pose from there."""

    stamp_ns: int
    keyframe: int
    offset: Pose


@dataclass(frozen=True)
class Island:
    """A connected part of the map: the numbers of its keyframes, and of its scans."""

    keyframes: NDArray[np.int64]
    scans: NDArray[np.int64]


class Mapper:
    """Builds a map from odometry and scans, in the order of their times.

    The map's frame is that of the base at the first scan. A robot that is moved by hand starts a
    new island of the map; it is joined to the others once a place is recognized.
    """

    def __init__(self, farthest: float) -> None:
        """Start a map of surfaces up to `farthest` [m] from the scanner."""
        self.graph = PoseGraph()
        self.keyframes: list[Keyframe] = []
        self.submaps: list[Submap] = []
        self.trajectory: list[Step] = []
        self.closer = LoopCloser()
        self.tracker = ScanTracker()
        self._farthest = farthest
        self._odometry: Pose | None = None
        self._pose: Pose = (0.0, 0.0, 0.0)
        self._island = 0  # number of the first keyframe since the robot was moved
        self._open = Submap(0, 0, -1)
        self._way = 0.0
        # Closures since the last optimization, and the number of keyframes then.
        self._unsolved, self._solved_at = 0, 0
        self._misfits = 0  # scans in a row that fitted nowhere

    @property
    def pose(self) -> Pose:
        """The pose of the base in the map at the last scan."""
        return self._pose

    def add_scan(self, stamp_ns: int, odometry: Pose, rays: Rays) -> Tracked:
        """Add a scan.

        Args:
            stamp_ns: time of the scan [ns].
            odometry: pose of the base in the odometry frame at that time.
            rays: in the frame of the base at that time.

        """
        cloud = scan_cloud(rays, self._farthest)
        if self._odometry is None:
            tracked = Tracked(self._pose, np.zeros((3, 3)), None)
        else:
            step = relative(self._odometry, odometry)
            tracked = self.tracker.track(self._pose, step, cloud)
        self._odometry = odometry
        self._pose = tracked.pose
        if tracked.is_lost:
            self._start_island()
        last = len(self.keyframes) - 1
        is_first = last < self._island
        offset = (0.0, 0.0, 0.0) if is_first else relative(self.graph.pose(last), self._pose)
        has_moved = apart(offset, (0.0, 0.0, 0.0), _KEYFRAME_M, _KEYFRAME_RAD)
        # If a scan that does not fit became a keyframe, those after it would fit to it.
        if is_first or (has_moved and not tracked.is_misfit):
            frame = Keyframe(stamp_ns, odometry, cloud, scan_rays(rays), self._open.number)
            self._add_keyframe(frame, None if is_first else (offset, tracked))
            last, offset = last + 1, (0.0, 0.0, 0.0)
        if tracked.is_lost:
            self._move_steps(self._misfits, last)
        self._misfits = self._misfits + 1 if tracked.is_misfit and not tracked.is_lost else 0
        self.trajectory.append(Step(stamp_ns, last, offset))
        return tracked

    @property
    def islands(self) -> list[Island]:
        """The parts of the map that nothing connects, the one with the most scans first.

        Only the first one is the map. Where the robot was moved by hand, and no place was
        recognized afterward, the position of the others relative to it is unknown.
        """
        first = self.graph.islands()
        numbers = first[[step.keyframe for step in self.trajectory]]
        islands = [
            Island(np.flatnonzero(first == number), np.flatnonzero(numbers == number))
            for number in np.unique(numbers).tolist()
        ]
        return sorted(islands, key=lambda one: (-len(one.scans), int(one.keyframes[0])))

    def poses(self) -> Array:
        """Return the pose (n, 3) of the base in the map at each scan."""
        poses = [compose(self.graph.pose(step.keyframe), step.offset) for step in self.trajectory]
        return np.array(poses).reshape(-1, 3)

    def finish(self, progress: Progress | None = None) -> None:
        """Close the last loops, and align all keyframes to those that saw the same."""
        report = progress or _ignore
        if self._open.last >= self._open.first:
            self._close_submap()
        self._solved_at = 0
        planned = self.closer.pending
        while self.closer.pending:
            self._close_loops(_COMPARED)
            report("loops", 1.0 - self.closer.pending / planned)
        if self._unsolved:
            self._unsolved = 0
            self.graph.optimize()
        for number, reach in enumerate(_REACH_M):
            self._align_neighbors(reach, partial(_report_round, report, number))
            self.graph.optimize()

    def _start_island(self) -> None:
        if self._open.last >= self._open.first:
            self._close_submap()
        self._island = len(self.keyframes)
        self.tracker.start()

    def _move_steps(self, count: int, keyframe: int) -> None:
        """Attach the last steps to another keyframe: the robot was moved before them."""
        for k in range(len(self.trajectory) - count, len(self.trajectory)):
            step = self.trajectory[k]
            pose = compose(self.graph.pose(step.keyframe), step.offset)
            offset = relative(self.graph.pose(keyframe), pose)
            self.trajectory[k] = Step(step.stamp_ns, keyframe, offset)

    def _add_keyframe(self, frame: Keyframe, step: tuple[Pose, Tracked] | None) -> None:
        number = self.graph.add_pose(self._pose)
        self.keyframes.append(frame)
        if step is not None:
            offset, tracked = step
            information = turned(tracked.information, self._pose[2])
            self.graph.edges.append(Edge(EdgeKind.STEP, number - 1, number, offset, information))
            self._way += math.hypot(offset[0], offset[1])
        self._open.last = number
        length = number - self._open.first + 1
        if self._way > _SUBMAP_M or length > _SUBMAP_KEYFRAMES:
            self._close_submap()
        self._close_loops(_COMPARED)
        first = max(self._island, number + 1 - _SURROUNDINGS)
        members = list(range(first, number + 1))
        cloud = cloud_in((0.0, 0.0, 0.0), members, self.keyframes, self.graph.poses)
        self.tracker.set_surroundings(cloud.thinned(DENSE_M))

    def _close_submap(self) -> None:
        self.submaps.append(self._open)
        self.closer.add(self.submaps, self.keyframes, self.graph)
        self._open = Submap(len(self.submaps), len(self.keyframes), len(self.keyframes) - 1)
        self._way = 0.0

    def _close_loops(self, most: int) -> None:
        found = self.closer.work(most, self.submaps, self.graph)
        self.graph.edges += found
        self._unsolved += len(found)
        count = len(self.keyframes)
        if self._unsolved and count - self._solved_at >= count // _KEYFRAMES_PER_PAUSE:
            self._unsolved, self._solved_at = 0, count
            last = self.graph.pose(len(self.keyframes) - 1)
            self.graph.optimize()
            self._pose = compose(
                self.graph.pose(len(self.keyframes) - 1), relative(last, self._pose)
            )

    def _align_neighbors(self, reach: float, report: Callable[[float], None]) -> None:
        """Replace the constraints between neighbors by new alignments."""
        index = PlaceIndex()
        poses = self.graph.poses
        for frame, (x, y, theta) in zip(self.keyframes, poses.tolist(), strict=True):
            index.add(frame.cloud, (x, y, theta))
        edges = [edge for edge in self.graph.edges if edge.kind is not EdgeKind.MATCH]
        islands = self.graph.islands()
        done: set[tuple[int, int]] = set()
        for number in range(len(self.keyframes)):
            if number % 20 == 0:
                report(number / len(self.keyframes))
            partners: list[int] = []
            for share, other in index.overlaps(number):
                if share < _SHARED or len(partners) == _PARTNERS:
                    break
                if islands[other] == islands[number] and all(
                    abs(other - known) >= _BETWEEN for known in (number, *partners)
                ):
                    partners.append(other)
            for other in partners:
                pair = (min(number, other), max(number, other))
                if pair not in done:
                    done.add(pair)
                    edge = self._match(number, other, reach)
                    if edge is not None:
                        edges.append(edge)
        self.graph.edges = edges

    def _match(self, number: int, other: int, reach: float) -> Edge | None:
        """Return the alignment of a keyframe to another one and those beside it."""
        base = self.graph.pose(other)
        submap = self.keyframes[other].submap
        members = [
            k
            for k in range(max(0, other - _BESIDE), min(len(self.keyframes), other + _BESIDE + 1))
            if k != number and abs(self.keyframes[k].submap - submap) <= 1
        ]
        cloud = cloud_in(base, members, self.keyframes, self.graph.poses).thinned(DENSE_M)
        if not cloud.count:
            return None
        guess = relative(base, self.graph.pose(number))
        prior = np.diag([0.1**-2, 0.1**-2, 0.05**-2])
        found = Reference(cloud).align(self.keyframes[number].cloud, guess, prior, reach)
        if (
            found.paired < _LEAST_PAIRED
            or found.deviation > _MOST_DEVIATION
            or apart(guess, found.pose, _MOVED_M, _MOVED_RAD)
        ):
            return None
        information = turned(found.information, found.pose[2])
        return Edge(EdgeKind.MATCH, other, number, found.pose, information)


def _report_round(report: Progress, number: int, share: float) -> None:
    report("alignment", (number + share) / len(_REACH_M))


def _ignore(stage: str, share: float) -> None:
    pass
