"""Mapping: makes keyframes and submaps of scans, and keeps the pose graph consistent."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.slam.alignment import NEAREST_M, WIDE_M, Reference
from cairn.components.slam.closures import LoopCloser
from cairn.components.slam.correlation import REACH_M
from cairn.components.slam.keyframes import (
    Keyframe,
    PlaceIndex,
    Submap,
    cloud_in,
    scan_cloud,
    scan_rays,
    scan_surfaces,
)
from cairn.components.slam.landmarks import LandmarkBuilder, LandmarkReport
from cairn.components.slam.odometry_calibration import (
    NOT_ESTIMATED,
    corrected_step,
    estimate_calibration,
    with_gains,
)
from cairn.components.slam.odometry_log import OdometryCalibration, OdometryLog, OdometryPath
from cairn.components.slam.point_cloud import NOTHING, PointCloud
from cairn.components.slam.pose_graph import AGREES, Edge, EdgeKind, PoseGraph, turned
from cairn.components.slam.tracking import ScanTracker, Tracked
from cairn.planar.motion_model import MEASURED, MotionModel, move_pose, odometry_step
from cairn.planar.odometry import FASTEST_WHEELS
from cairn.planar.odometry_gains import AS_CONFIGURED, GainEstimator
from cairn.planar.poses import Pose, apart, compose, distance, relative, wrap
from cairn.planar.renewals import Renewals
from cairn.planar.scans import Rays
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

# A keyframe is made after so much motion [m], [rad].
_KEYFRAME = 0.2
# Scans are aligned to so many keyframes before them, and a submap has so many.
_SUBMAP = 25
# Pairs of submaps that are compared while a keyframe is added: about 10 ms each.
_COMPARED = 2
# When the map is finished: keyframes that share this much of what they see are aligned again, with
# this many around the partner on each side; so many partners, whose surroundings do not overlap.
_SHARED, _BESIDE, _PARTNERS = 0.35, 2, 6
# Without scans for this long [ns], odometry continues the trajectory, with poses at least so far
# apart in time [ns].
_SILENT_NS, _TRAJECTORY_NS = 1_000_000_000, 100_000_000
# Where scans changed at once while the robot drove, odometry may be off by this [m], [rad].
_JUMP = 1.0

Progress = Callable[[str, float, str], None]
"""Called with the name of a stage, its completed share [0 to 1], and what was done, in words."""


@dataclass(frozen=True, slots=True)
class Step:
    """A scan of the trajectory: its time [ns], the keyframe before it, and the pose from there."""

    stamp_ns: int
    keyframe: int
    offset: Pose


class Mapper:
    """Builds a map from odometry and scans, in the order of their times.

    The map's frame is that of the base at the first scan. A robot that is moved by hand starts a
    new island of the map; it is joined to the others once a place is recognized.
    """

    def __init__(self, farthest: float, model: MotionModel = MEASURED) -> None:
        """Start a map.

        Where no scan shows how the robot moved, odometry does.

        Args:
            farthest: surfaces farther from the scanner are ignored [m].
            model: the uncertainty of odometry.

        """
        self.graph = PoseGraph()
        self.keyframes: list[Keyframe] = []
        self.submaps: list[Submap] = []
        self.trajectory: list[Step] = []
        self.closer = LoopCloser()
        self.tracker = ScanTracker(model)
        self.farthest = farthest
        self.renewals = Renewals()
        """Where only keyframes from a version of the map on count."""
        self.version = 0
        """Version of the map, which new keyframes get."""
        self.pose: Pose = (0.0, 0.0, 0.0)
        """The pose of the base in the map at the last scan or, without scans, observation."""
        self._odometry: Pose | None = None
        self._island = 0  # number of the first keyframe since the robot was moved
        self._open = Submap(0, 0, -1)
        self._driven_on: list[int] = []  # first keyframes of islands to which the robot drove
        self._model = model
        self._log = OdometryLog()
        self._scanned_ns: int | None = None
        self._builder = LandmarkBuilder(self.graph)
        self.calibration = NOT_ESTIMATED
        """How the robot moves when odometry states a motion: its gains are estimated while driving
        by scans; and with the lag, by all, when the map is finished."""
        self._gains = GainEstimator(model, AS_CONFIGURED)
        self._continues = False  # the next scan is the first since the map was read
        # Whether closures or observations contradict the poses, and the number of keyframes at the
        # last optimization.
        self._is_contradicted, self._solved_at = False, 0
        # With which calibration the step to a keyframe was tracked, and how it depends on odometry.
        self._tracked_with: dict[int, tuple[OdometryCalibration, Array]] = {}
        self._misfits = 0  # scans in a row that fitted nowhere
        self._in_map_of: tuple[object, NDArray[np.bool_], object] = (None, np.zeros(0, bool), None)

    @property
    def is_located(self) -> bool:
        """Whether the robot is on the map, and on no island beside it."""
        return bool(self.keyframes) and bool(self.in_map()[-1])

    def add_scan(self, stamp_ns: int, odometry: Pose, rays: Rays) -> Tracked:
        """Add a scan.

        Args:
            stamp_ns: time of the scan [ns].
            odometry: pose of the base in the odometry frame at that time.
            rays: in the frame of the base at that time.

        """
        self._log.add(stamp_ns, odometry)
        self._scanned_ns = stamp_ns
        cloud = scan_cloud(rays, self.farthest)
        if self._continues:
            self._continues = False
            tracked = self._find_near(stamp_ns, odometry, cloud)
        elif self._odometry is None:
            tracked = Tracked(self.pose, np.zeros((3, 3)), None)
        else:
            step = odometry_step(relative(self._odometry, odometry))
            moved = move_pose((0.0, 0.0, 0.0), self.calibration.calibration.corrected(step))
            tracked = self.tracker.track(self.pose, moved, cloud, self._gains.uncertain)
            self._gains.move(step)
            # Of these scans the map is made: where they show nothing, it is where odometry puts it.
            ended = not tracked.is_shown and self._gains.conclude()
            if self._gains.add(tracked.pose, shown=tracked.is_shown) or ended:
                self.calibration = with_gains(self.calibration, self._gains)
        self._odometry = odometry
        self.pose = tracked.pose
        if tracked.is_lost:
            self._start_island()
            if tracked.is_driven:
                self._driven_on.append(len(self.keyframes))
        last = len(self.keyframes) - 1
        is_first = last < self._island
        offset = (0.0, 0.0, 0.0) if is_first else relative(self.graph.pose(last), self.pose)
        has_moved = _is_another(offset)
        # If a scan that does not fit became a keyframe, those after it would fit to it.
        if is_first or (has_moved and not tracked.is_misfit):
            frame = Keyframe(
                stamp_ns, odometry, scan_surfaces(cloud),
                scan_rays(rays) if rays.ranges.size else None, self._open.number, self.version,
            )  # fmt: skip
            self._add_keyframe(frame, None if is_first else (offset, tracked))
            last, offset = last + 1, (0.0, 0.0, 0.0)
        if tracked.is_lost:
            self._move_steps(self._misfits, last)
        self._misfits = self._misfits + 1 if tracked.is_misfit and not tracked.is_lost else 0
        self.trajectory.append(Step(stamp_ns, last, offset))
        return tracked

    def add_odometry(self, stamp_ns: int, odometry: Pose) -> None:
        """Add the pose of the base in the odometry frame at a time [ns].

        While there are no scans, odometry and landmarks show the robot's way.
        """
        self._log.add(stamp_ns, odometry)
        if self._has_scans(stamp_ns):
            return
        if not self.trajectory or stamp_ns >= self.trajectory[-1].stamp_ns + _TRAJECTORY_NS:
            self._continue(stamp_ns, odometry)

    def add_observations(
        self, stamp_ns: int, odometry: Pose, observations: Sequence[Observation]
    ) -> None:
        """Add the objects that were recognized in an image.

        Args:
            stamp_ns: time of the image [ns].
            odometry: pose of the base in the odometry frame at that time.
            observations: in the frame of the base at that time.

        """
        self._log.add(stamp_ns, odometry)
        if not observations:
            return
        if not self._has_scans(stamp_ns):
            self._continue(stamp_ns, odometry)
        last = len(self.keyframes) - 1
        at_ns = self.keyframes[last].stamp_ns
        path = self._log.path(self.calibration.calibration, min(at_ns, stamp_ns))
        for one in observations:
            if self._builder.add(last, stamp_ns, one, path, at_ns):
                self._is_contradicted = True
        self._settle_in_time()

    def resume(self, *, here: bool) -> None:
        """Continue a map that was read from a file.

        With `here`, the robot is near the last keyframe if its next scan fits there. Otherwise it
        may be anywhere: it extends the map, on a new island until a place of it is recognized.
        """
        first = self.submaps[-1].last + 1 if self.submaps else 0
        self._open = Submap(len(self.submaps), first, len(self.keyframes) - 1)
        self._odometry = None
        self._builder.resume()
        if here and self.keyframes:
            last = len(self.keyframes) - 1
            self._log.add(self.keyframes[last].stamp_ns, self.keyframes[last].odometry)
            self._odometry, self.pose = self.keyframes[last].odometry, self.graph.pose(last)
            islands = self.graph.islands()
            self._island = int(np.flatnonzero(islands == islands[last])[0])
            self._set_surroundings()
            self.tracker.usual_fit = 1.0
            self._continues = True
        else:
            self.graph.extended = len(self.keyframes)
            self._start_island()

    def in_map(self) -> NDArray[np.bool_]:
        """Return which keyframes (n,) belong to the map: see `PoseGraph.in_map`.

        An island that no recognized place joins to it has no position in the map.
        """
        graph = self.graph
        # Each optimization makes new arrays; what else connects poses is only added in between.
        state = (id(graph.poses), id(graph.edges), len(graph.edges), len(graph.sightings))
        if state != self._in_map_of[0]:
            within = graph.in_map()
            within.flags.writeable = False
            # The arrays are kept, so that no other ones get their identities.
            self._in_map_of = state, within, (graph.poses, graph.edges)
        return self._in_map_of[1]

    def poses(self) -> Array:
        """Return the pose (n, 3) of the base in the map at each scan; NaN outside of the map."""
        poses = np.array(
            [compose(self.graph.pose(step.keyframe), step.offset) for step in self.trajectory]
        ).reshape(-1, 3)
        known = self.in_map()[[step.keyframe for step in self.trajectory]]
        poses[~known] = np.nan
        return poses

    def landmarks(self) -> LandmarkReport:
        """Return the landmarks, and what became of the observations, of the finished map."""
        return self._builder.report()

    def settle(self) -> None:
        """Move the keyframes to where closures and observations put them that are not used yet."""
        if not self._is_contradicted:
            return
        self._is_contradicted, self._solved_at = False, len(self.keyframes)
        last = self.graph.pose(len(self.keyframes) - 1)
        self.graph.optimize_quickly()
        self.pose = compose(self.graph.pose(len(self.keyframes) - 1), relative(last, self.pose))
        self._gains.interrupt()
        # The next scan is aligned to where the keyframes are now.
        self._set_surroundings()

    def finish(self, progress: Progress | None = None) -> None:
        """Close the last loops, and align all keyframes to those that saw the same."""
        report = progress or _ignore
        if self._open.last >= self._open.first:
            self._close_submap()
        self._correct_steps()
        self._solved_at = 0
        planned = self.closer.pending
        while self.closer.pending:
            self._close_loops(_COMPARED)
            compared, loops = planned - self.closer.pending, self.closer.counts.accepted
            done = f"{compared:,} of {planned:,} pairs of places compared, {loops:,} loops closed"
            report("loops", compared / planned, done)
        joined, depends = self._join_driven(), self.graph.depends_on_odometry
        if self._is_contradicted or joined or depends:
            self._is_contradicted = False
            self.graph.optimize()
        if depends:
            self._use_landmarks()
        if self._scanned_ns is None:
            return
        rounds = (WIDE_M, NEAREST_M)
        for number, reach in enumerate(rounds):
            self._align_neighbors(reach, partial(_report_round, report, number, len(rounds)))
            self.graph.optimize()
        self._use_landmarks()

    def _correct_steps(self) -> None:
        """Correct what odometry has stated before its gains were known."""
        if not self._tracked_with:
            return
        path, stamps = self._log.path(OdometryCalibration()), self._stamps()
        for k, edge in enumerate(self.graph.edges):
            if edge.kind is EdgeKind.STEP and edge.second in self._tracked_with:
                start, end = path.at(stamps[[edge.first, edge.second]]).tolist()
                before, by_odometry = self._tracked_with.pop(edge.second)
                self.graph.edges[k] = corrected_step(
                    edge, relative(start, end), by_odometry, before, self.calibration
                )
                self._is_contradicted = True

    def _join_driven(self) -> bool:
        """Join islands to which the robot drove, and of which no place was recognized, by odometry.

        Return whether there are any.
        """
        if not self._driven_on:
            return False
        joined = False
        islands, stamps = self.graph.islands(), self._stamps()
        path = self._log.path(self.calibration.calibration)
        for number in self._driven_on:
            before = number - 1
            if islands[before] != islands[number] and stamps[before] >= path.origin_ns:
                start, end = path.at(stamps[[before, number]]).tolist()
                known = _JUMP**-2.0 * np.eye(3)
                edge = Edge(EdgeKind.JUMP, before, number, relative(start, end), known)
                self.graph.edges.append(edge)
                joined = True
        self._driven_on = []
        return joined

    def _use_landmarks(self) -> None:
        """Estimate the odometry; optimize with it, and with observations that became clear."""
        stamps = self._stamps()
        self.calibration = estimate_calibration(
            self.calibration, self._log, self._model, stamps, self.graph, self._builder
        )
        if not self.graph.depends_on_odometry:
            return
        path = self._log.path(self.calibration.calibration)
        self._builder.resolve(path, stamps)
        self.graph.optimize()
        while self._builder.split_moved():
            self.graph.optimize()
        if self._builder.join_places():
            self.graph.optimize()
        self.trajectory = [
            step
            if self.keyframes[step.keyframe].rays is not None
            else replace(step, offset=self._offset(path, step.keyframe, step.stamp_ns))
            for step in self.trajectory
        ]

    def _stamps(self) -> NDArray[np.int64]:
        return np.array([frame.stamp_ns for frame in self.keyframes], np.int64)

    def _has_scans(self, stamp_ns: int) -> bool:
        return self._scanned_ns is not None and stamp_ns - self._scanned_ns < _SILENT_NS

    def _continue(self, stamp_ns: int, odometry: Pose) -> None:
        """Continue the trajectory by odometry; make a keyframe where that moved."""
        last = len(self.keyframes) - 1
        is_first = last < self._island
        offset = (0.0, 0.0, 0.0)
        if not is_first:
            path = self._log.path(self.calibration.calibration, self.keyframes[last].stamp_ns)
            offset = self._offset(path, last, stamp_ns)
            self.pose = compose(self.graph.pose(last), offset)
        self._odometry = odometry
        if is_first or _is_another(offset):
            nothing = scan_surfaces(NOTHING)
            self._add_keyframe(Keyframe(stamp_ns, odometry, nothing, None, self._open.number), None)
            last, offset = last + 1, (0.0, 0.0, 0.0)
        self.trajectory.append(Step(stamp_ns, last, offset))

    def _offset(self, path: OdometryPath, keyframe: int, stamp_ns: int) -> Pose:
        """Return the pose of the base at a time, by odometry, in the frame of a keyframe."""
        start, end = path.at(np.array([self.keyframes[keyframe].stamp_ns, stamp_ns])).tolist()
        return relative(start, end)

    def _settle_in_time(self) -> None:
        """Optimize the graph, in 0.1 s per 8,000 keyframes, at a bounded cost per keyframe."""
        count = len(self.keyframes)
        if count - self._solved_at >= max(math.isqrt(count), count // 100):
            self.settle()

    def _find_near(self, stamp_ns: int, odometry: Pose, cloud: PointCloud) -> Tracked:
        """Return where the first scan of a continued map was taken, if that is near its end."""
        last = self.keyframes[-1]
        reach = FASTEST_WHEELS.speed * (stamp_ns - last.stamp_ns) / SECOND
        tracked = Tracked(self.pose, np.zeros((3, 3)), 0.0, is_misfit=True)
        if distance(last.odometry, odometry) <= reach:
            tracked = self.tracker.track(self.pose, relative(last.odometry, odometry), cloud)
        # If odometry has restarted as well, the robot is near, unless that was long ago.
        if tracked.is_misfit and 0.0 <= reach < REACH_M:
            tracked = self.tracker.locate(self.pose, cloud, reach)
        return replace(tracked, is_lost=tracked.is_misfit)

    def _start_island(self) -> None:
        if self._open.last >= self._open.first:
            self._close_submap()
        self._island = len(self.keyframes)
        self.tracker.start()
        self._gains.interrupt()

    def _move_steps(self, count: int, keyframe: int) -> None:
        """Attach the last steps to another keyframe: the robot was moved before them."""
        for k in range(len(self.trajectory) - count, len(self.trajectory)):
            step = self.trajectory[k]
            pose = compose(self.graph.pose(step.keyframe), step.offset)
            offset = relative(self.graph.pose(keyframe), pose)
            self.trajectory[k] = Step(step.stamp_ns, keyframe, offset)

    def _add_keyframe(self, frame: Keyframe, step: tuple[Pose, Tracked] | None) -> None:
        number = self.graph.add_pose(self.pose)
        self.keyframes.append(frame)
        if number > self._island:
            edge = self._edge_to(number, step)
            self.graph.edges.append(edge)
        self._open.last = number
        if number - self._open.first >= _SUBMAP:
            self._close_submap()
        self._close_loops(_COMPARED)
        if frame.rays is not None:
            self._set_surroundings()

    def _set_surroundings(self) -> None:
        count = len(self.keyframes)
        members = list(range(max(self._island, count - _SUBMAP), count))
        cloud = cloud_in((0.0, 0.0, 0.0), members, self.keyframes, self.graph.poses)
        self.tracker.set_surroundings(cloud.thinned())

    def _edge_to(self, number: int, step: tuple[Pose, Tracked] | None) -> Edge:
        """Return the constraint from the keyframe before: by scans if both have one that fits."""
        if step is None or step[1].fit is None or self.keyframes[number - 1].rays is None:
            start_ns, end_ns = (frame.stamp_ns for frame in self.keyframes[number - 1 : number + 1])
            path = self._log.path(self.calibration.calibration, start_ns)
            motion = path.motion(start_ns, end_ns, self._model)
            return Edge(EdgeKind.ODOMETRY, number - 1, number, *motion)
        offset, tracked = step
        information = turned(tracked.information, self.pose[2])
        by_odometry = turned(tracked.by_odometry, self.pose[2])
        self._tracked_with[number] = self.calibration.calibration, by_odometry
        return Edge(EdgeKind.STEP, number - 1, number, offset, information)

    def _close_submap(self) -> None:
        self.submaps.append(self._open)
        members = self.keyframes[self._open.first : self._open.last + 1]
        if any(frame.rays is not None for frame in members):
            self.closer.add(self.submaps, self.keyframes, self.graph)
        self._open = Submap(len(self.submaps), len(self.keyframes), len(self.keyframes) - 1)

    def _close_loops(self, most: int) -> None:
        found = self.closer.work(most, self.submaps, self.graph)
        self.graph.edges += found
        self._is_contradicted |= bool(found)
        self._settle_in_time()

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
                    abs(other - known) >= 2 * _BESIDE for known in (number, *partners)
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
        cloud = cloud_in(base, members, self.keyframes, self.graph.poses).thinned()
        if not cloud.count:
            return None
        guess = relative(base, self.graph.pose(number))
        prior = np.diag([0.1**-2, 0.1**-2, 0.05**-2])
        found = Reference(cloud).align(self.keyframes[number].cloud, guess, prior, reach)
        moved = np.subtract(found.pose, guess)
        moved[2] = wrap(moved[2])
        if not found.pairs or moved @ prior @ moved > AGREES**2:
            return None
        information = turned(found.information, found.pose[2])
        return Edge(EdgeKind.MATCH, other, number, found.pose, information)


def _is_another(offset: Pose) -> bool:
    """Return whether a pose is another one than that of the last keyframe, seen from there."""
    return apart(offset, (0.0, 0.0, 0.0), _KEYFRAME, _KEYFRAME)


def _report_round(report: Progress, number: int, rounds: int, share: float) -> None:
    report("alignment", (number + share) / rounds, f"round {number + 1} of {rounds}")


def _ignore(stage: str, share: float, done: str) -> None:
    pass
