"""The pose graph: poses, what relates them, and their optimization by GTSAM."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from heapq import heappop, heappush
from itertools import chain, combinations
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cairn.components.slam.alignment import LEAST_INFORMATION
from cairn.components.slam.chains import Chains, chains_of, turn_back
from cairn.components.slam.keyframes import pose_of
from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose, compose, wrap_all

Array = NDArray[np.float64]

AGREES = 3.7
"""A measurement agrees up to so many standard deviations: one in 1000 is off by more."""

# A constraint's error from which on it counts less, in standard deviations: for alignments of
# neighbors (Cauchy), places that were recognized (Geman and McClure: it may be wrong altogether),
# and observations of landmarks (Cauchy: one in fifty is of something else). The kernels of
# constraints with large errors start wider and are halved until they have this width (graduated
# non-convexity, Yang et al. 2020).
_KERNEL = 2.0
# The uncertainty of each constraint, beyond what its information says, when the drift along a path
# is predicted [m], [rad]: the errors of successive alignments have a common sign.
_DRIFT_M, _DRIFT_RAD = 0.006, math.radians(0.12)
# Landmarks that two parts of the map have in common are equally far from each other up to this [m].
_SAME_M = 0.4
# Landmarks that are paired to move a part to another one, and poses that represent the map when
# covariances relative to it are computed.
_MOST_CHOSEN = 30
_ANCHOR_SD = 1e-4  # of the pose that stays [m], [rad]


class EdgeKind(IntEnum):
    """What a constraint between two poses follows from."""

    STEP = 0
    """Odometry and the alignment to the scans just before: nothing contradicts it."""
    MATCH = 1
    """The alignment of two scans whose relation was known well."""
    CLOSURE = 2
    """A place that was recognized."""
    ODOMETRY = 3
    """Odometry alone, as no scan supports it."""
    JUMP = 4
    """Odometry where scans changed at once: it may be far off."""


@dataclass(frozen=True, slots=True)
class Edge:
    """A constraint: the pose of keyframe `second` in the frame of `first`.

    `information` (3, 3) is that of x, y [m] and heading [rad] in the frame of `second`.
    """

    kind: EdgeKind
    first: int
    second: int
    measured: Pose
    information: Array


@dataclass(frozen=True, slots=True)
class Sighting:
    """A constraint: landmark `landmark` at `range_m` [m] and `bearing` [rad] from a keyframe."""

    keyframe: int
    landmark: int
    range_m: float
    bearing: float
    range_sd: float
    bearing_sd: float


class PoseGraph:
    """Poses of keyframes, numbered from 0, positions of landmarks, and constraints between them."""

    def __init__(self) -> None:
        self.poses = np.zeros((0, 3))
        self.landmarks: dict[int, tuple[float, float]] = {}
        self.edges: list[Edge] = []
        self.sightings: list[Sighting] = []
        self.rejected = 0
        """Number of closures that turned out to be wrong and were removed."""
        self.extended = 0
        """Number of poses of the map that this one extends, which come first."""

    def add_pose(self, pose: Pose) -> int:
        """Add a pose; return its number."""
        self.poses = np.vstack((self.poses, pose))
        return len(self.poses) - 1

    def pose(self, number: int) -> Pose:
        """Return a pose."""
        return pose_of(self.poses, number)

    def add_sighting(self, sighting: Sighting) -> None:
        """Add an observation of a landmark, which is where its first observation puts it."""
        self.sightings.append(sighting)
        if sighting.landmark not in self.landmarks:
            x, y, theta = self.pose(sighting.keyframe)
            direction = theta + sighting.bearing
            self.landmarks[sighting.landmark] = (
                x + sighting.range_m * math.cos(direction),
                y + sighting.range_m * math.sin(direction),
            )

    @property
    def depends_on_odometry(self) -> bool:
        """Whether there are observations, or steps that no scan supports."""
        odometry = (edge.kind is EdgeKind.ODOMETRY for edge in self.edges)
        return bool(self.sightings) or any(odometry)

    def islands(self) -> NDArray[np.int64]:
        """Return for each pose (n,) the first one to which constraints connect it.

        Two landmarks that both parts have observed connect them, too, if they are equally far from
        each other in both.
        """
        return self._islands()[0]

    def in_map(self) -> NDArray[np.bool_]:
        """Return which poses (n,) belong to the map: the island with the most of them.

        If it extends another map, it is that map and what is joined to it: a robot that does not
        recognize the place replaces nothing.
        """
        islands = self.islands()
        numbers, sizes = np.unique(islands[: self.extended or None], return_counts=True)
        within: NDArray[np.bool_] = islands == (numbers[np.argmax(sizes)] if numbers.size else 0)
        return within

    def _islands(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first pose of the island (n,), and of the part without landmarks (n,)."""
        ends = np.array([(e.first, e.second) for e in self.edges], np.int64).reshape(-1, 2)
        count = len(self.poses)
        links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (count, count))
        _, labels = connected_components(links, directed=False)
        parts = np.unique(labels, return_index=True)[1][labels]
        if len(np.unique(parts)) == 1 or not self.sightings:
            return parts, parts
        islands = parts.copy()
        while True:
            for first, second in combinations(np.unique(islands).tolist(), 2):
                if self._alignment(islands, first, second) is not None:
                    islands[islands == second] = first
                    break
            else:
                return islands, parts

    def _alignment(self, parts: NDArray[np.int64], first: int, second: int) -> Pose | None:
        """Return how to move the poses of one part so that its landmarks are those of another."""
        places = self._places(parts)
        of_first, of_second = places.get(first, {}), places.get(second, {})
        shared = sorted(set(of_first) & set(of_second))
        if len(shared) < 2:
            return None
        return aligned(
            np.array([of_second[k] for k in shared]), np.array([of_first[k] for k in shared])
        )

    def _places(self, parts: NDArray[np.int64]) -> dict[int, dict[int, Array]]:
        """Return for each part where it has seen landmarks (2,), the median of its sightings."""
        seen: dict[int, dict[int, list[Array]]] = {}
        points = self.sighted_points()
        for s, point in zip(self.sightings, points, strict=True):
            seen.setdefault(int(parts[s.keyframe]), {}).setdefault(s.landmark, []).append(point)
        return {
            part: {k: np.median(np.array(found), axis=0) for k, found in landmarks.items()}
            for part, landmarks in seen.items()
        }

    def sighted_points(self) -> Array:
        """Return where each observation (n, 2) puts its landmark [m]."""
        rows = [(s.keyframe, s.range_m, s.bearing) for s in self.sightings]
        table = np.array(rows).reshape(-1, 3)
        poses = self.poses[table[:, 0].astype(int)]
        direction = poses[:, 2] + table[:, 2]
        ways = table[:, 1:2] * np.column_stack((np.cos(direction), np.sin(direction)))
        points: Array = poses[:, :2] + ways
        return points

    def _joined_rows(self) -> NDArray[np.int64]:
        """Return the rows of sightings from the islands of their landmarks.

        A landmark belongs to the island that has seen it first. What others see of it says nothing
        as long as they are not connected.
        """
        islands, _ = self._islands()
        home: dict[int, int] = {}
        rows = []
        for row, s in enumerate(self.sightings):
            island = int(islands[s.keyframe])
            if home.setdefault(s.landmark, island) == island:
                rows.append(row)
        return np.array(rows, np.int64)

    def _align_parts(self) -> None:
        """Move parts that only landmarks connect to where these landmarks are."""
        islands, parts = self._islands()
        waiting = np.unique(parts[parts != islands]).tolist()
        placed = np.where(parts == islands, islands, -1)
        while waiting:
            for part in waiting:
                members = np.flatnonzero(parts == part)
                groups = placed.copy()
                groups[members] = part
                island = int(islands[part])
                moved = self._alignment(groups, island, part)
                if moved is not None:
                    break
            else:
                return
            for number in members.tolist():
                self.poses[number] = compose(moved, self.pose(number))
            placed[members] = island
            waiting.remove(part)

    def optimize_quickly(self) -> None:
        """Do the same as `optimize`, with each chain of steps as one constraint.

        The result differs from that of `optimize` by fractions of a millimeter. The effort depends
        on the number of closures and observations; that of a step is about a microsecond.
        """
        steps: dict[int, Edge] = {}
        others: list[Edge] = []
        for edge in self.edges:
            is_step = edge.kind in (EdgeKind.STEP, EdgeKind.ODOMETRY)
            if is_step and edge.second == edge.first + 1 and edge.second not in steps:
                steps[edge.second] = edge
            else:
                others.append(edge)
        kept = {number for edge in others for number in (edge.first, edge.second)}
        kept.update(sighting.keyframe for sighting in self.sightings)
        listed = [(number, one.measured, one.information) for number, one in steps.items()]
        chains = chains_of(len(self.poses), listed, kept)
        small, renumbered = self._without_chains(chains, others)
        small.optimize()
        alive = {id(edge) for edge in small.edges}
        gone = {id(other) for edge, other in renumbered if id(edge) not in alive}
        if gone:
            self.edges = [edge for edge in self.edges if id(edge) not in gone]
        self.rejected += small.rejected
        self.landmarks = small.landmarks
        self.poses = chains.spread(small.poses)

    def _without_chains(
        self, chains: Chains, others: list[Edge]
    ) -> tuple[PoseGraph, list[tuple[Edge, Edge]]]:
        """Return the graph of the nodes, and its other edges beside what they were."""
        small = PoseGraph()
        small.poses = self.poses[chains.nodes]
        small.landmarks = dict(self.landmarks)
        number_of = {number: k for k, number in enumerate(chains.nodes.tolist())}
        renumbered = [
            (replace(one, first=number_of[one.first], second=number_of[one.second]), one)
            for one in others
        ]
        motions, information = chains.joined()
        small.edges = [
            Edge(EdgeKind.STEP, k - 1, k, (x, y, theta), information[k])
            for k, (x, y, theta) in enumerate(motions.tolist())
            if chains.steps[k]
        ] + [edge for edge, _ in renumbered]
        small.sightings = [replace(one, keyframe=number_of[one.keyframe]) for one in self.sightings]
        return small, renumbered

    def optimize(self) -> None:
        """Move poses and landmarks to where they agree best with the constraints.

        The first pose of each island stays. Closures that contradict the others are removed.
        """
        self._align_parts()
        closures = [edge.kind is EdgeKind.CLOSURE for edge in self.edges]
        closure = float(self.deviations()[closures].max(initial=0.0)) / _KERNEL
        sightings = self.sighting_deviations(self.sightings)[self._joined_rows()]
        sighting = float(sightings.max(initial=0.0)) / _KERNEL
        stages = math.ceil(math.log2(max(1.0, closure, sighting)))
        start = self.poses, dict(self.landmarks)
        for stage in range(stages, -1, -1):
            error = self.minimize(2.0**stage)
        if stages and closure <= 1.0:
            # Many gross errors lead the wide kernels astray: the poses may have been nearly right.
            far = self.poses, self.landmarks
            self.poses, self.landmarks = start
            if self.minimize() > error:
                self.poses, self.landmarks = far
        wrong = self.deviations() > AGREES
        kept = [
            edge
            for edge, is_wrong in zip(self.edges, wrong.tolist(), strict=True)
            if edge.kind is not EdgeKind.CLOSURE or not is_wrong
        ]
        if len(kept) < len(self.edges):
            self.rejected += len(self.edges) - len(kept)
            self.edges = kept
            self.minimize()

    def minimize(self, widened: float = 1.0) -> float:
        """Minimize the error from where poses and landmarks are; return what remains of it.

        The kernels of constraints with large errors are `widened`.
        """
        rows = self._joined_rows()
        graph, values = self._factors(rows, widened), self._values()
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(30)
        parameters.setRelativeErrorTol(1e-4)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        result = optimizer.optimize()
        self.poses = np.array(
            [(p.x(), p.y(), p.theta()) for p in map(result.atPose2, range(len(self.poses)))]
        ).reshape(-1, 3)
        for landmark in self.landmarks:
            x, y = result.atPoint2(_landmark_key(landmark)).tolist()
            self.landmarks[landmark] = (x, y)
        remaining: float = optimizer.error()
        return remaining

    def _values(self) -> gtsam.Values:
        values = gtsam.Values()
        for number, (x, y, theta) in enumerate(self.poses.tolist()):
            values.insert(number, gtsam.Pose2(x, y, theta))
        for landmark, position in self.landmarks.items():
            values.insert(_landmark_key(landmark), np.array(position))
        return values

    def _factors(self, rows: NDArray[np.int64], widened: float) -> gtsam.NonlinearFactorGraph:
        """Return the constraints, with these rows of sightings, as factors."""
        graph = gtsam.NonlinearFactorGraph()
        for factor in self._anchors():
            graph.add(factor)
        for edge in self.edges:
            graph.add(_edge_factor(edge, widened))
        for row in rows.tolist():
            graph.add(_sighting_factor(self.sightings[row], widened))
        return graph

    def _anchors(self) -> Iterator[gtsam.NonlinearFactor]:
        anchor = gtsam.noiseModel.Isotropic.Sigma(3, _ANCHOR_SD)
        for first in np.unique(self.islands()).tolist():
            yield gtsam.PriorFactorPose2(first, gtsam.Pose2(*self.pose(first)), anchor)

    def correction(
        self,
        motions: Sequence[Edge],
        by_motion: Array,
        by_sighting: Array,
        expected: Array,
        information: Array,
    ) -> tuple[Array, Array]:
        """Return the change of parameters of measurements with which they agree best.

        Poses and landmarks adapt to the change: the result is the minimum over all of them, for
        errors that are linear in the change.

        Args:
            motions: constraints (n) that depend on the parameters; they replace those of
                `EdgeKind.ODOMETRY`.
            by_motion: (n, 3, p) derivatives of the motions, in the frame of `second`.
            by_sighting: (m, 2, p) derivatives of range and bearing of `sightings`.
            expected: (p,) change that is expected without measurements.
            information: (p, p) of that.

        Returns:
            The change (p,) and its covariance (p, p).

        """
        values = self._values()
        linear = gtsam.GaussianFactorGraph()
        kept = (edge for edge in self.edges if edge.kind is not EdgeKind.ODOMETRY)
        for factor in chain(self._anchors(), (_edge_factor(edge, 1.0) for edge in kept)):
            linear.add(factor.linearize(values))
        # Without it, a chain of thousands of poses is not solved in double precision.
        least, nothing = np.sqrt(LEAST_INFORMATION), np.zeros(3)
        for number in range(len(self.poses)):
            linear.add(
                gtsam.JacobianFactor(number, least, nothing, gtsam.noiseModel.Unit.Create(3))
            )
        key, unit = gtsam.symbol("c", 0), gtsam.noiseModel.Unit.Create
        for edge, derivative in zip(motions, by_motion, strict=True):
            jacobian, residual = _edge_factor(edge, 1.0).linearize(values).jacobian()
            by = -np.linalg.cholesky(edge.information).T @ derivative
            first, second = jacobian[:, :3], jacobian[:, 3:]
            linear.add(
                gtsam.JacobianFactor(
                    edge.first, first, edge.second, second, key, by, residual, unit(3)
                )
            )
        deviations = self.sighting_deviations(self.sightings)
        for row in self._joined_rows().tolist():
            s = self.sightings[row]
            jacobian, residual = _sighting_factor(s, 1.0).linearize(values).jacobian()
            # The weight of an error by Cauchy's kernel, as it is in the jacobian.
            weight = 1.0 / math.hypot(1.0, deviations[row] / _KERNEL)
            by = -weight / np.array([[s.bearing_sd], [s.range_sd]]) * by_sighting[row][::-1]
            pose, point = jacobian[:, :3], jacobian[:, 3:]
            linear.add(
                gtsam.JacobianFactor(
                    s.keyframe, pose, _landmark_key(s.landmark), point, key, by, residual, unit(2)
                )
            )
        root = np.linalg.cholesky(information).T
        linear.add(gtsam.JacobianFactor(key, root, root @ expected, unit(len(root))))
        change: Array = linear.optimize().at(key)
        covariance: Array = gtsam.Marginals(linear, values).marginalCovariance(key)
        return change, covariance

    def sighting_deviations(self, sightings: Sequence[Sighting]) -> Array:
        """Return how far observations (n,) are from where landmarks are, in standard deviations."""
        rows = [
            (*self.landmarks[s.landmark], s.range_m, s.bearing, s.range_sd, s.bearing_sd)
            for s in sightings
        ]
        x, y, ranges, bearings, range_sd, bearing_sd = np.array(rows).reshape(-1, 6).T
        poses = self.poses[[s.keyframe for s in sightings]].reshape(-1, 3)
        dx, dy = x - poses[:, 0], y - poses[:, 1]
        turn = wrap_all(np.arctan2(dy, dx) - poses[:, 2] - bearings)
        deviations: Array = np.hypot((np.hypot(dx, dy) - ranges) / range_sd, turn / bearing_sd)
        return deviations

    def deviations(self) -> Array:
        """Return the error of each constraint in standard deviations (n,), whitened as a norm."""
        if not self.edges:
            return np.zeros(0)
        errors = self.errors()
        information = np.array([edge.information for edge in self.edges])
        squares = np.einsum("ni,nij,nj->n", errors, information, errors)
        deviations: Array = np.sqrt(np.maximum(squares, 0.0))
        return deviations

    def errors(self) -> Array:
        """Return the error (n, 3) of each constraint: x, y [m], heading [rad], as `information`."""
        ends = np.array([(edge.first, edge.second) for edge in self.edges]).reshape(-1, 2)
        measured = np.array([edge.measured for edge in self.edges]).reshape(-1, 3)
        actual = relative_all(self.poses[ends[:, 0]], self.poses[ends[:, 1]])
        return relative_all(measured, actual)

    def landmark_covariances(self) -> dict[int, Array]:
        """Return the covariance (2, 2) [m^2] of each landmark relative to the map as a whole.

        Relative to the first pose, all landmarks together are as uncertain as its heading. So the
        motion of the whole map, of landmarks and of poses that saw them, is taken out.
        """
        rows = self._joined_rows()
        marginals = gtsam.Marginals(self._factors(rows, 1.0), self._values())
        islands = self.islands()
        members: dict[int, tuple[set[int], set[int]]] = {}
        for row in rows.tolist():
            s = self.sightings[row]
            landmarks, poses = members.setdefault(int(islands[s.keyframe]), (set(), set()))
            landmarks.add(s.landmark)
            poses.add(s.keyframe)
        found: dict[int, Array] = {}
        for landmarks, poses in members.values():
            every = sorted(poses)[:: max(1, len(poses) // _MOST_CHOSEN)]
            found |= self._relative_covariances(marginals, sorted(landmarks), every)
        return found

    def _relative_covariances(
        self, marginals: gtsam.Marginals, landmarks: list[int], poses: list[int]
    ) -> dict[int, Array]:
        joint = marginals.jointMarginalCovariance([*poses, *map(_landmark_key, landmarks)])
        blocks = [(number, self.poses[number, :2], self._turned(number)) for number in poses]
        blocks += [(_landmark_key(k), np.array(self.landmarks[k]), np.eye(2)) for k in landmarks]
        covariance = np.block(
            [[a @ joint.at(i, j) @ b.T for j, _, b in blocks] for i, _, a in blocks]
        )
        offset = np.array([point for _, point, _ in blocks])
        offset -= offset.mean(axis=0)
        motions = np.zeros((2 * len(blocks), 3))
        motions[0::2, 0] = motions[1::2, 1] = 1.0
        motions[0::2, 2], motions[1::2, 2] = -offset[:, 1], offset[:, 0]
        kept = np.eye(len(motions)) - motions @ np.linalg.pinv(motions)
        covariance = kept @ covariance @ kept.T
        start = 2 * len(poses)
        return {
            k: covariance[start + 2 * i : start + 2 * i + 2, start + 2 * i : start + 2 * i + 2]
            for i, k in enumerate(landmarks)
        }

    def _turned(self, number: int) -> Array:
        """Return the derivative (2, 3) of a pose's position by its local coordinates."""
        cosine, sine = math.cos(self.poses[number, 2]), math.sin(self.poses[number, 2])
        return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0]])

    def drift(self, origin: int) -> Array:
        """Return the covariances (n, 3, 3) of all poses as seen from one of them.

        Each is that of the most certain path (Olson 2009), over x, y [m] and heading [rad] in the
        frame of the pose itself. Infinite where no path leads.
        """
        count = len(self.poses)
        ends = np.array([(e.first, e.second) for e in self.edges], np.int64).reshape(-1, 2)
        measured = np.array([e.measured for e in self.edges]).reshape(-1, 3)
        information = np.array([e.information for e in self.edges]).reshape(-1, 3, 3)
        floor = np.diag([_DRIFT_M**2, _DRIFT_M**2, _DRIFT_RAD**2])
        inverses = np.asarray(np.linalg.inv(information + LEAST_INFORMATION), np.float64)
        covariances = inverses + floor
        both = np.concatenate((ends, ends[:, ::-1]))
        order = np.argsort(both[:, 0], kind="stable")
        first = np.concatenate(
            (np.zeros(1, np.int64), np.cumsum(np.bincount(both[:, 0], minlength=count)))
        )
        return _drift(origin, count, first, order, both, measured, covariances)


def turned(matrix: Array, heading: float) -> Array:
    """Return an information or covariance (3, 3) in the frame of a pose with this heading."""
    cosine, sine = math.cos(heading), math.sin(heading)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    result: Array = rotation.T @ matrix @ rotation
    return result


def relative_all(origins: Array, poses: Array) -> Array:
    """Return poses (n, 3) in the frames of others (n, 3), row by row."""
    offset = poses - origins
    cosine, sine = np.cos(origins[:, 2]), np.sin(origins[:, 2])
    turn = wrap_all(offset[:, 2])
    return np.column_stack(
        (
            cosine * offset[:, 0] + sine * offset[:, 1],
            cosine * offset[:, 1] - sine * offset[:, 0],
            turn,
        )
    )


def aligned(points: Array, targets: Array) -> Pose | None:
    """Return the motion that puts points (n, 2) to where most of their targets (n, 2) are.

    It follows from a pair of points that are equally far from each other in both, and farther than
    that is uncertain; None if no pair is.
    """
    best: tuple[int, float, list[int]] | None = None
    chosen = range(0, len(points), 1 + len(points) // _MOST_CHOSEN)
    for i, j in combinations(chosen, 2):
        a, b = points[j] - points[i], targets[j] - targets[i]
        far = math.hypot(*a)
        if far < 2 * _SAME_M or abs(far - math.hypot(*b)) > _SAME_M:
            continue
        errors = np.hypot(*(_moved(points, _fit(points[[i, j]], targets[[i, j]])) - targets).T)
        agree = np.flatnonzero(errors < _SAME_M).tolist()
        found = (-len(agree), float(errors[agree].sum()), agree)
        if len(agree) >= 2 and (best is None or found < best):
            best = found
    return None if best is None else _fit(points[best[2]], targets[best[2]])


def _fit(points: Array, targets: Array) -> Pose:
    """Return the motion that puts points nearest to their targets (Umeyama 1991)."""
    middle, target = points.mean(axis=0), targets.mean(axis=0)
    product = (points - middle).T @ (targets - target)
    turn = math.atan2(product[0, 1] - product[1, 0], product[0, 0] + product[1, 1])
    x, y = (target - _moved(middle[None], (0.0, 0.0, turn))[0]).tolist()
    return x, y, turn


def _moved(points: Array, motion: Pose) -> Array:
    cosine, sine = math.cos(motion[2]), math.sin(motion[2])
    moved: Array = points @ np.array([[cosine, sine], [-sine, cosine]]) + motion[:2]
    return moved


def _edge_factor(edge: Edge, widened: float) -> gtsam.BetweenFactorPose2:
    noise: Any = gtsam.noiseModel.Gaussian.Information(edge.information)
    estimator, robust = gtsam.noiseModel.mEstimator, gtsam.noiseModel.Robust.Create
    if edge.kind is EdgeKind.MATCH:
        noise = robust(estimator.Cauchy.Create(_KERNEL), noise)
    elif edge.kind is EdgeKind.CLOSURE:
        noise = robust(estimator.GemanMcClure.Create(_KERNEL * widened), noise)
    return gtsam.BetweenFactorPose2(edge.first, edge.second, gtsam.Pose2(*edge.measured), noise)


def _sighting_factor(s: Sighting, widened: float) -> gtsam.BearingRangeFactor2D:
    deviations = gtsam.noiseModel.Diagonal.Sigmas(np.array([s.bearing_sd, s.range_sd]))
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(_KERNEL * widened)
    noise = gtsam.noiseModel.Robust.Create(kernel, deviations)
    key, bearing = _landmark_key(s.landmark), gtsam.Rot2(s.bearing)
    return gtsam.BearingRangeFactor2D(s.keyframe, key, bearing, s.range_m, noise)


def _landmark_key(landmark: int) -> int:
    key: int = gtsam.symbol("l", landmark)
    return key


@compiled(
    "float64[:, :, ::1](int64, int64, int64[::1], int64[::1], int64[:, ::1], float64[:, ::1],"
    " float64[:, :, ::1])"
)
def _drift(
    origin: int,
    count: int,
    first: NDArray[np.int64],
    order: NDArray[np.int64],
    ends: NDArray[np.int64],
    measured: Array,
    covariances: Array,
) -> Array:
    """Dijkstra's shortest paths by the variance of the position."""
    edges = len(measured)
    found = np.full((count, 3, 3), np.inf)
    best = np.full(count, np.inf)
    done = np.zeros(count, np.bool_)
    found[origin] = 0.0
    best[origin] = 0.0
    heap = [(0.0, origin)]
    adjoint = np.zeros((3, 3))
    while len(heap) > 0:
        _, a = heappop(heap)
        if done[a]:
            continue
        done[a] = True
        for k in range(first[a], first[a + 1]):
            row = order[k]
            backward = row >= edges
            edge = row - edges if backward else row
            b = ends[row, 1]
            if done[b]:
                continue
            noise = covariances[edge]
            if backward:
                x, y, turn = measured[edge, 0], measured[edge, 1], measured[edge, 2]
                cosine, sine = math.cos(turn), math.sin(turn)
                # The adjoint of the measurement turns its noise to the frame of `first`.
                adjoint[0, 0], adjoint[0, 1], adjoint[0, 2] = cosine, -sine, y
                adjoint[1, 0], adjoint[1, 1], adjoint[1, 2] = sine, cosine, -x
                adjoint[2, 0], adjoint[2, 1], adjoint[2, 2] = 0.0, 0.0, 1.0
                covariance = adjoint @ (found[a] + noise) @ adjoint.T
            else:
                turn_back(measured[edge], adjoint)
                covariance = adjoint @ found[a] @ adjoint.T + noise
            variance = covariance[0, 0] + covariance[1, 1]
            if variance < best[b]:
                best[b] = variance
                found[b] = covariance
                heappush(heap, (variance, b))
    return found
