"""Leave-one-out clouds: the robot's pose by all objects, and by all objects but one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from components.localizer.motion import Increment, MotionModel, move_cloud
from components.localizer.object_likelihood import Landmark, Sighting, object_log_likelihood
from components.localizer.particles import (
    Estimate,
    estimate,
    narrow,
    normalised,
    systematic_choice,
)

Array = NDArray[np.float64]
ALL = 0


class Bank:
    """Clouds of `count` poses each: row 0 fuses every object, row b every one but `left_out[b]`.

    An object that was moved drags the cloud that fuses it to its lie, sighting after sighting,
    until it seems to agree. So each object is judged by a cloud that never fused it. Rows are
    made when an object is first seen and go to the object seen longest ago when all are taken.
    """

    def __init__(
        self, count: int, rows: int, model: MotionModel, random: np.random.Generator
    ) -> None:
        self.count = count
        self.rows = rows
        self.model = model
        self.random = random
        self.poses: Array = np.zeros((3, 1, count))
        self.log_weights: Array = np.zeros((1, count))
        self._row_of: dict[int, int] = {}  # insertion order: seen longest ago first

    def scatter(self, mean: Sequence[float], covariance: Array) -> None:
        """Draw row 0 from a Gaussian (x [m], y [m], theta [rad]) and drop the other rows."""
        spread = np.linalg.cholesky(covariance + 1e-9 * np.eye(3))
        noise = spread @ self.random.standard_normal((3, self.count))
        self.settle(np.asarray(mean, dtype=np.float64)[:, None] + noise)

    def settle(self, poses: Array) -> None:
        """Make `poses` (3, count) row 0 and drop the other rows."""
        self.poses = np.array(poses, dtype=np.float64)[:, None, :]
        self.log_weights = np.zeros((1, self.count))
        self._row_of.clear()

    def move(self, step: Increment) -> None:
        """Move all clouds by the commanded motion `step`."""
        move_cloud(self.poses, step, self.model, self.random)

    def estimate(self) -> Estimate:
        """The robot's pose by every object."""
        return estimate(self.poses[:, ALL], self.log_weights[ALL])

    def estimate_without(self, object_id: int) -> Estimate:
        """The robot's pose by every object but this one."""
        row = self._row_of.get(object_id, ALL)
        return estimate(self.poses[:, row], self.log_weights[row])

    def watch(self, object_id: int) -> None:
        """See to it that `object_id` has a row that does not fuse it from now on."""
        if self.rows == 0:
            return
        row = self._row_of.pop(object_id, None)
        if row is None:
            if len(self._row_of) < self.rows:
                row = self.log_weights.shape[0]
                self.poses = np.concatenate([self.poses, self.poses[:, :1]], axis=1)
                self.log_weights = np.concatenate([self.log_weights, self.log_weights[:1]])
            else:
                row = self._row_of.pop(next(iter(self._row_of)))
                self._copy(ALL, row)
        self._row_of[object_id] = row

    def fuse(
        self, sightings: Sequence[Sighting], landmarks: Mapping[int, Landmark], independence: float
    ) -> None:
        """Fuse sightings of mapped objects; each counts `independence` (0..1] of its likelihood."""

        def log_likelihood(poses: Array) -> Array:
            total = np.zeros(poses.shape[1:])
            for sighting in sightings:
                part = independence * object_log_likelihood(
                    poses, sighting, landmarks[sighting.object_id]
                )
                row = self._row_of.get(sighting.object_id)
                if row is not None:
                    part[row] = 0.0
                total += part
            return total

        narrow(self.poses, self.log_weights, log_likelihood, self.random)

    def believe_without(self, object_id: int) -> None:
        """Forget all that was fused of `object_id`: its cloud becomes everyone's."""
        row = self._row_of.pop(object_id, None)
        if row is None:
            return
        for other in range(self.log_weights.shape[0]):
            if other != row:
                self._copy(row, other)
        last = self.log_weights.shape[0] - 1
        for name, taken in self._row_of.items():
            if taken == last:
                self._row_of[name] = row
        self.poses[:, row] = self.poses[:, last]
        self.log_weights[row] = self.log_weights[last]
        self.poses = self.poses[:, :last].copy()
        self.log_weights = self.log_weights[:last].copy()

    def sample(self, count: int) -> Array:
        """`count` equally weighted poses (3, count) of row 0, for show: draws no random number."""
        weights = normalised(self.log_weights[ALL])
        chosen = systematic_choice(weights, count, np.random.default_rng(0))
        drawn: Array = self.poses[:, ALL][:, chosen]
        return drawn

    def _copy(self, source: int, target: int) -> None:
        self.poses[:, target] = self.poses[:, source]
        self.log_weights[target] = self.log_weights[source]
