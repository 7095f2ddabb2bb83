"""The pose graph: poses, what relates them, and their optimization by GTSAM."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from heapq import heappop, heappush

import gtsam
import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose, wrap_all

Array = NDArray[np.float64]

# A constraint's error from which on it counts less, in standard deviations: for alignments of
# neighbors (Cauchy), places that were recognized (Geman and McClure: it may be wrong altogether),
# and observations of landmarks (Cauchy: one in fifty is of something else).
_MATCH_KERNEL, _CLOSURE_KERNEL, _SIGHTING_KERNEL = 2.0, 3.0, 2.0
# A closure whose error is larger after the optimization is wrong [standard deviations].
_WRONG_CLOSURE = 10.0
# The kernels of constraints with large errors start wider and are halved until they have their own
# width (graduated non-convexity, Yang et al. 2020).
_MOST_STAGES = 8
# The uncertainty of each constraint, beyond what its information says, when the drift along a path
# is predicted [m], [rad]: the errors of successive alignments have a common sign.
_DRIFT_M, _DRIFT_RAD = 0.006, math.radians(0.12)
_ANCHOR_SD = 1e-4  # of the pose that stays [m], [rad]


class EdgeKind(IntEnum):
    """What a constraint between two poses follows from."""

    STEP = 0
    """Odometry and the alignment to the scans just before: nothing contradicts it."""
    MATCH = 1
    """The alignment of two scans whose relation was known well."""
    CLOSURE = 2
    """A place that was recognized."""


@dataclass(frozen=True)
class Edge:
    """A constraint: the pose of keyframe `second` in the frame of `first`.

    `information` (3, 3) is that of x, y [m] and heading [rad] in the frame of `second`.
    """

    kind: EdgeKind
    first: int
    second: int
    measured: Pose
    information: Array


@dataclass(frozen=True)
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

    def add_pose(self, pose: Pose) -> int:
        """Add a pose; return its number."""
        self.poses = np.vstack((self.poses, pose))
        return len(self.poses) - 1

    def pose(self, number: int) -> Pose:
        """Return a pose."""
        x, y, theta = self.poses[number].tolist()
        return x, y, theta

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

    def islands(self) -> NDArray[np.int64]:
        """Return for each pose (n,) the first one to which constraints connect it."""
        parent = list(range(len(self.poses)))

        def root(node: int) -> int:
            while parent[node] != node:
                parent[node] = parent[parent[node]]
                node = parent[node]
            return node

        seen_by: dict[int, int] = {}
        pairs = [(edge.first, edge.second) for edge in self.edges]
        pairs += [(seen_by.setdefault(s.landmark, s.keyframe), s.keyframe) for s in self.sightings]
        for a, b in pairs:
            low, high = sorted((root(a), root(b)))
            parent[high] = low
        return np.array([root(node) for node in range(len(parent))], np.int64)

    def optimize(self) -> None:
        """Move poses and landmarks to where they agree best with the constraints.

        The first pose of each island stays. Closures that contradict the others are removed.
        """
        widest = 0.0
        if self.edges:
            closures = np.array([edge.kind is EdgeKind.CLOSURE for edge in self.edges])
            widest = float(self.deviations()[closures].max(initial=0.0)) / _CLOSURE_KERNEL
        if self.sightings:
            widest = max(widest, float(self.sighting_deviations().max()) / _SIGHTING_KERNEL)
        stages = min(_MOST_STAGES, max(0, math.ceil(math.log2(max(1.0, widest)))))
        for stage in range(stages, -1, -1):
            self._optimize(2.0**stage)
        wrong = self.deviations() > _WRONG_CLOSURE
        kept = [
            edge
            for edge, is_wrong in zip(self.edges, wrong.tolist(), strict=True)
            if edge.kind is not EdgeKind.CLOSURE or not is_wrong
        ]
        if len(kept) < len(self.edges):
            self.rejected += len(self.edges) - len(kept)
            self.edges = kept
            self._optimize(1.0)

    def _optimize(self, widened: float) -> None:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for number, (x, y, theta) in enumerate(self.poses.tolist()):
            values.insert(number, gtsam.Pose2(x, y, theta))
        for landmark, position in self.landmarks.items():
            values.insert(_landmark_key(landmark), np.array(position))
        anchor = gtsam.noiseModel.Isotropic.Sigma(3, _ANCHOR_SD)
        for first in np.unique(self.islands()).tolist():
            graph.add(gtsam.PriorFactorPose2(first, values.atPose2(first), anchor))
        estimator, robust = gtsam.noiseModel.mEstimator, gtsam.noiseModel.Robust.Create
        kernels = {
            EdgeKind.MATCH: estimator.Cauchy.Create(_MATCH_KERNEL),
            EdgeKind.CLOSURE: estimator.GemanMcClure.Create(_CLOSURE_KERNEL * widened),
        }
        for edge in self.edges:
            noise = gtsam.noiseModel.Gaussian.Information(edge.information)
            if edge.kind in kernels:
                noise = robust(kernels[edge.kind], noise)
            measured = gtsam.Pose2(*edge.measured)
            graph.add(gtsam.BetweenFactorPose2(edge.first, edge.second, measured, noise))
        kernel = estimator.Cauchy.Create(_SIGHTING_KERNEL * widened)
        for s in self.sightings:
            deviations = np.array([s.bearing_sd, s.range_sd])
            noise = robust(kernel, gtsam.noiseModel.Diagonal.Sigmas(deviations))
            graph.add(
                gtsam.BearingRangeFactor2D(
                    s.keyframe, _landmark_key(s.landmark), gtsam.Rot2(s.bearing), s.range_m, noise
                )
            )
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(30)
        parameters.setRelativeErrorTol(1e-4)
        result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        self.poses = np.array(
            [(p.x(), p.y(), p.theta()) for p in map(result.atPose2, range(len(self.poses)))]
        ).reshape(-1, 3)
        for landmark in self.landmarks:
            x, y = result.atPoint2(_landmark_key(landmark)).tolist()
            self.landmarks[landmark] = (x, y)

    def sighting_deviations(self) -> Array:
        """Return the error of each observation (n,) in standard deviations."""
        rows = [
            (*self.landmarks[s.landmark], s.range_m, s.bearing, s.range_sd, s.bearing_sd)
            for s in self.sightings
        ]
        x, y, ranges, bearings, range_sd, bearing_sd = np.array(rows).reshape(-1, 6).T
        poses = self.poses[[s.keyframe for s in self.sightings]].reshape(-1, 3)
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
        covariances = np.linalg.inv(information + 1e-6 * np.eye(3)) + floor
        both = np.concatenate((ends, ends[:, ::-1]))
        order = np.argsort(both[:, 0], kind="stable")
        first = np.concatenate((np.zeros(1, np.int64), np.cumsum(np.bincount(both[:, 0], minlength=count))))
        return _drift(origin, count, first, order, both, measured, covariances)


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
        cost, a = heappop(heap)
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
            x, y, turn = measured[edge, 0], measured[edge, 1], measured[edge, 2]
            cosine, sine = math.cos(turn), math.sin(turn)
            noise = covariances[edge]
            if backward:
                # The adjoint of the measurement turns its noise to the frame of `first`.
                adjoint[0, 0], adjoint[0, 1], adjoint[0, 2] = cosine, -sine, y
                adjoint[1, 0], adjoint[1, 1], adjoint[1, 2] = sine, cosine, -x
                adjoint[2, 0], adjoint[2, 1], adjoint[2, 2] = 0.0, 0.0, 1.0
                covariance = adjoint @ (found[a] + noise) @ adjoint.T
            else:
                adjoint[0, 0], adjoint[0, 1] = cosine, sine
                adjoint[1, 0], adjoint[1, 1] = -sine, cosine
                adjoint[0, 2] = -(cosine * y - sine * x)
                adjoint[1, 2] = sine * y + cosine * x
                adjoint[2, 0], adjoint[2, 1], adjoint[2, 2] = 0.0, 0.0, 1.0
                covariance = adjoint @ found[a] @ adjoint.T + noise
            variance = covariance[0, 0] + covariance[1, 1]
            if variance < best[b]:
                best[b] = variance
                found[b] = covariance
                heappush(heap, (variance, b))
    return found
