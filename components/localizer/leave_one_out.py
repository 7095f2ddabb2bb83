"""Leave-one-out filters: the pose by all objects, and by all but one object each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.observations import Landmark, object_log_likelihood
from cairn.components.localizer.odometry import move_particles
from cairn.components.localizer.particle_set import (
    ParticleSet,
    PoseEstimate,
    estimate,
    gaussian_noise,
    normalized,
    systematic_choice,
    tempered_update,
)
from cairn.planar.motion_model import OdometryStep
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]


class LeaveOneOutFilters:
    """The particle set that fuses every object, and up to `rows` sets of `count` poses without one
    object.

    An object that was moved drags a filter that fuses it toward its wrong position, observation
    after observation, until it seems to agree. So each object is compared with a filter that never
    fused it. A row is assigned when an object is first observed; when all are taken, the object
    observed longest ago loses its row.
    """

    def __init__(self, particles: ParticleSet, count: int, rows: int) -> None:
        self.particles = particles
        self.count = count
        self.rows = rows
        self.random = particles.random
        self.poses: Array = np.zeros((3, 0, count))
        self.log_weights: Array = np.zeros((0, count))
        self._row_of: dict[int, int] = {}  # in the order of the last observation

    def set_gaussian(self, mean: Sequence[float], covariance: Array) -> None:
        """Draw the full particle set from a Gaussian (x [m], y [m], theta [rad]); drop the
        others.
        """
        self.particles.set_gaussian(mean, covariance)
        self._drop()

    def set_particles(self, poses: Array) -> None:
        """Replace the full particle set by `poses` (3, n); drop the others."""
        self.particles.set_particles(poses)
        self._drop()

    def move(self, step: OdometryStep) -> None:
        """Move all particle sets by a step of odometry."""
        self.particles.move(step)
        if self._row_of:
            move_particles(self.poses, step, self.particles.model, self.random)

    def widen(self, covariance: Array) -> None:
        """Add noise of this covariance (3, 3) to every particle."""
        for poses in (self.particles.poses, self.poses):
            flat = poses.reshape(3, -1)
            flat += gaussian_noise(covariance, flat.shape[1], self.random)

    def estimate(self) -> PoseEstimate:
        """Return the robot's pose by every object."""
        return self.particles.estimate()

    def estimate_without(self, object_id: int) -> PoseEstimate:
        """Return the robot's pose by every object but this one."""
        row = self._row_of.get(object_id)
        if row is None:
            return self.particles.estimate()
        return estimate(self.poses[:, row], self.log_weights[row])

    def ensure_filter(self, object_id: int) -> None:
        """Make sure that `object_id` has a row that does not fuse it from now on."""
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
            self.poses[:, row] = self.particles.sample(self.count, self.random)
            self.log_weights[row] = 0.0
        self._row_of[object_id] = row

    def fuse_objects(
        self,
        observations: Sequence[Observation],
        landmarks: Mapping[int, Landmark],
        independence: float,
    ) -> None:
        """Fuse observations of mapped objects; the share `independence` (0, 1] of each counts."""

        def of_one(poses: Array, observation: Observation) -> Array:
            landmark = landmarks[observation.object_id]
            return independence * object_log_likelihood(poses, observation, landmark)

        def of_all(poses: Array) -> Array:
            total = np.zeros(poses.shape[1:])
            for observation in observations:
                total += of_one(poses, observation)
            return total

        def of_others(poses: Array, rows: NDArray[np.intp]) -> Array:
            total = np.zeros(poses.shape[1:])
            for observation in observations:
                added = of_one(poses, observation)
                added[rows == self._row_of.get(observation.object_id, -1)] = 0.0
                total += added
            return total

        self.particles.fuse(of_all)
        if self._row_of:
            tempered_update(self.poses, self.log_weights, of_others, self.random)

    def fuse_scan(self, log_likelihood: Callable[[Array], Array]) -> None:
        """Fuse a scan; `log_likelihood` returns (n,) for poses (3, n)."""

        def of_rows(poses: Array, _: NDArray[np.intp]) -> Array:
            return log_likelihood(poses.reshape(3, -1)).reshape(poses.shape[1:])

        self.particles.fuse(log_likelihood)
        if self._row_of:
            tempered_update(self.poses, self.log_weights, of_rows, self.random)

    def replace_by_filter_without(self, object_id: int) -> None:
        """Remove all that was fused of `object_id`: the filter without it replaces all others."""
        row = self._row_of.pop(object_id, None)
        if row is None:
            return
        weights = normalized(self.log_weights[row])
        chosen = systematic_choice(weights, self.particles.count, self.random)
        self.particles.set_particles(self.poses[:, row][:, chosen])
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
