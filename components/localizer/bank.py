"""Leave-one-out clouds: the robot's pose by all that is known, and by all but one object."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.cloud import Cloud
from cairn.components.localizer.motion import Increment, move_cloud
from cairn.components.localizer.object_likelihood import Landmark, Sighting, object_log_likelihood
from cairn.components.localizer.particles import (
    Estimate,
    estimate,
    narrow,
    normalized,
    systematic_choice,
)

Array = NDArray[np.float64]


class Bank:
    """`cloud`, which fuses every object, and up to `rows` clouds of `count` poses that leave one
    out.

    An object that was moved drags the cloud that fuses it to its lie, sighting after sighting,
    until it seems to agree. So each object is judged by a cloud that never fused it. Rows are
    made when an object is first seen and go to the object seen longest ago when all are taken.
    """

    def __init__(self, cloud: Cloud, count: int, rows: int) -> None:
        self.cloud = cloud
        self.count = count
        self.rows = rows
        self.random = cloud.random
        self.poses: Array = np.zeros((3, 0, count))
        self.log_weights: Array = np.zeros((0, count))
        self._row_of: dict[int, int] = {}  # insertion order: seen longest ago first

    def scatter(self, mean: Sequence[float], covariance: Array) -> None:
        """Draw the cloud from a Gaussian (x [m], y [m], theta [rad]) and drop the others."""
        self.cloud.scatter(mean, covariance)
        self._drop()

    def settle(self, poses: Array) -> None:
        """Make `poses` (3, n) the cloud and drop the others."""
        self.cloud.settle(poses)
        self._drop()

    def move(self, step: Increment) -> None:
        """Move all clouds by what odometry told."""
        self.cloud.move(step)
        if self._row_of:
            move_cloud(self.poses, step, self.cloud.model, self.random)

    def widen(self, deviation_m: float, deviation_rad: float) -> None:
        """Scatter every pose about itself."""
        for poses in (self.cloud.poses, self.poses):
            noise = self.random.standard_normal(poses.shape)
            noise[:2] *= deviation_m
            noise[2] *= deviation_rad
            poses += noise

    def estimate(self) -> Estimate:
        """The robot's pose by every object."""
        return self.cloud.estimate()

    def estimate_without(self, object_id: int) -> Estimate:
        """The robot's pose by every object but this one."""
        row = self._row_of.get(object_id)
        if row is None:
            return self.cloud.estimate()
        return estimate(self.poses[:, row], self.log_weights[row])

    def watch(self, object_id: int) -> None:
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
        self, sightings: Sequence[Sighting], landmarks: Mapping[int, Landmark], independence: float
    ) -> None:
        """Fuse sightings of mapped objects; each counts `independence` (0..1] of its likelihood."""

        def part(poses: Array, sighting: Sighting) -> Array:
            landmark = landmarks[sighting.object_id]
            return independence * object_log_likelihood(poses, sighting, landmark)

        def all_of_them(poses: Array) -> Array:
            total = np.zeros(poses.shape[1:])
            for sighting in sightings:
                total += part(poses, sighting)
            return total

        def all_but_its_own(poses: Array, rows: NDArray[np.intp]) -> Array:
            total = np.zeros(poses.shape[1:])
            for sighting in sightings:
                added = part(poses, sighting)
                added[rows == self._row_of.get(sighting.object_id, -1)] = 0.0
                total += added
            return total

        self.cloud.fuse(all_of_them)
        if self._row_of:
            narrow(self.poses, self.log_weights, all_but_its_own, self.random)

    def fuse_scan(self, log_likelihood: Callable[[Array], Array]) -> None:
        """Fuse a scan, of which `log_likelihood` says how well it fits poses (3, n): (n,)."""

        def of_rows(poses: Array, _: NDArray[np.intp]) -> Array:
            return log_likelihood(poses.reshape(3, -1)).reshape(poses.shape[1:])

        self.cloud.fuse(log_likelihood)
        if self._row_of:
            narrow(self.poses, self.log_weights, of_rows, self.random)

    def believe_without(self, object_id: int) -> None:
        """Forget all that was fused of `object_id`: its cloud becomes everyone's."""
        row = self._row_of.pop(object_id, None)
        if row is None:
            return
        weights = normalized(self.log_weights[row])
        chosen = systematic_choice(weights, self.cloud.count, self.random)
        self.cloud.settle(self.poses[:, row][:, chosen])
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
