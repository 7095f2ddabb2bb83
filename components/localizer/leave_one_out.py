"""Leave-one-out filters: the pose by all objects, and by all but one object each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.observations import Landmark, Observation, object_log_likelihood
from cairn.components.localizer.odometry import OdometryStep, move_particles
from cairn.components.localizer.particle_set import (
    ParticleSet,
    PoseEstimate,
    estimate,
    normalized,
    systematic_choice,
    tempered_update,
)

Array = NDArray[np.float64]


class LeaveOneOutFilters:
    """`cloud`, which fuses every object, and up to `rows` clouds of `count` poses that leave one
    out.

    An object that was moved drags the cloud that fuses it to its lie, observation after observation,
    until it seems to agree. So each object is judged by a cloud that never fused it. Rows are
    made when an object is first seen and go to the object seen longest ago when all are taken.
    """

    def __init__(self, cloud: ParticleSet, count: int, rows: int) -> None:
        self.cloud = cloud
        self.count = count
        self.rows = rows
        self.random = cloud.random
        self.poses: Array = np.zeros((3, 0, count))
        self.log_weights: Array = np.zeros((0, count))
        self._row_of: dict[int, int] = {}  # insertion order: seen longest ago first

    def set_gaussian(self, mean: Sequence[float], covariance: Array) -> None:
        """Draw the cloud from a Gaussian (x [m], y [m], theta [rad]) and drop the others."""
        self.cloud.set_gaussian(mean, covariance)
        self._drop()

    def set_particles(self, poses: Array) -> None:
        """Make `poses` (3, n) the cloud and drop the others."""
        self.cloud.set_particles(poses)
        self._drop()

    def move(self, step: OdometryStep) -> None:
        """Move all clouds by what odometry told."""
        self.cloud.move(step)
        if self._row_of:
            move_particles(self.poses, step, self.cloud.model, self.random)

    def widen(self, deviation_m: float, deviation_rad: float) -> None:
        """Scatter every pose about itself."""
        for poses in (self.cloud.poses, self.poses):
            noise = self.random.standard_normal(poses.shape)
            noise[:2] *= deviation_m
            noise[2] *= deviation_rad
            poses += noise

    def estimate(self) -> PoseEstimate:
        """The robot's pose by every object."""
        return self.cloud.estimate()

    def estimate_without(self, object_id: int) -> PoseEstimate:
        """The robot's pose by every object but this one."""
        row = self._row_of.get(object_id)
        if row is None:
            return self.cloud.estimate()
        return estimate(self.poses[:, row], self.log_weights[row])

    def ensure_filter(self, object_id: int) -> None:
        """See to it that `object_id` has a row that does not fuse it from now on."""
        if self.rows == 0:
            return
        row = self._row_of.pop(object_id, None)
        if row is None:
            if len(self._row_of) < self.rows:
                row = len(self._row_of)
                self.poses = np.concatenate([self.poses, np.zeros((3, 1, self.count))], axis=1)
                self.log_weights = np.concatenate([self.log_weights, np.zeros((1, self.count))])
            else:
                row = self._row_of.pop(next(iter(self._row_of)))
            self.poses[:, row] = self.cloud.sample(self.count, self.random)
            self.log_weights[row] = 0.0
        self._row_of[object_id] = row

    def fuse_objects(
        self,
        observations: Sequence[Observation],
        landmarks: Mapping[int, Landmark],
        independence: float,
    ) -> None:
        """Fuse observations of mapped objects; each counts `independence` (0..1] of its likelihood."""

        def part(poses: Array, observation: Observation) -> Array:
            landmark = landmarks[observation.object_id]
            return independence * object_log_likelihood(poses, observation, landmark)

        def all_of_them(poses: Array) -> Array:
            total = np.zeros(poses.shape[1:])
            for observation in observations:
                total += part(poses, observation)
            return total

        def all_but_its_own(poses: Array, rows: NDArray[np.intp]) -> Array:
            total = np.zeros(poses.shape[1:])
            for observation in observations:
                added = part(poses, observation)
                added[rows == self._row_of.get(observation.object_id, -1)] = 0.0
                total += added
            return total

        self.cloud.fuse(all_of_them)
        if self._row_of:
            tempered_update(self.poses, self.log_weights, all_but_its_own, self.random)

    def fuse_scan(self, log_likelihood: Callable[[Array], Array]) -> None:
        """Fuse a scan, of which `log_likelihood` says how well it fits poses (3, n): (n,)."""

        def of_rows(poses: Array, _: NDArray[np.intp]) -> Array:
            return log_likelihood(poses.reshape(3, -1)).reshape(poses.shape[1:])

        self.cloud.fuse(log_likelihood)
        if self._row_of:
            tempered_update(self.poses, self.log_weights, of_rows, self.random)

    def replace_by_filter_without(self, object_id: int) -> None:
        """Forget all that was fused of `object_id`: its cloud becomes everyone's."""
        row = self._row_of.pop(object_id, None)
        if row is None:
            return
        weights = normalized(self.log_weights[row])
        chosen = systematic_choice(weights, self.cloud.count, self.random)
        self.cloud.set_particles(self.poses[:, row][:, chosen])
        for other in range(len(self.log_weights)):
            if other != row:
                self.poses[:, other] = self.poses[:, row]
                self.log_weights[other] = self.log_weights[row]
        last = len(self.log_weights) - 1
        for name, taken in self._row_of.items():
            if taken == last:
                self._row_of[name] = row
        self.poses = self.poses[:, :last].copy()
        self.log_weights = self.log_weights[:last].copy()

    def _drop(self) -> None:
        self.poses = np.zeros((3, 0, self.count))
        self.log_weights = np.zeros((0, self.count))
        self._row_of.clear()
