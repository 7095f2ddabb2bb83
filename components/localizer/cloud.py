"""The cloud of weighted poses that is the robot's pose; as many as its spread asks for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.motion import Increment, MotionModel, move_cloud
from cairn.components.localizer.particles import (
    Estimate,
    estimate,
    narrow,
    normalized,
    redraw,
    systematic_choice,
)
from cairn.planar.compiled import compiled

Array = NDArray[np.float64]

# Bins of the KLD bound: 0.25 m, 0.25 m, 10 degrees; error of the distribution 2 %, held with 99 %.
_BIN = np.array([0.25, 0.25, math.radians(10.0)])
_KLD_ERROR, _KLD_QUANTILE = 0.02, NormalDist().inv_cdf(0.99)
_FEW_BINS = 20_000
# Below this share of effective poses a likelihood is taken in stages.
_TOO_POOR = 0.05


class Cloud:
    """Poses (3, n) with log-weights (n,); n lies between `least` and `most`."""

    def __init__(
        self, least: int, most: int, model: MotionModel, random: np.random.Generator
    ) -> None:
        self.least, self.most = least, most
        self.model = model
        self.random = random
        self.poses: Array = np.zeros((3, least))
        self.log_weights: Array = np.zeros(least)

    @property
    def count(self) -> int:
        """Number of poses."""
        return self.log_weights.size

    def scatter(self, mean: Sequence[float], covariance: Array) -> None:
        """Draw all poses from a Gaussian over x [m], y [m], theta [rad]."""
        spread = np.linalg.cholesky(covariance + 1e-9 * np.eye(3))
        wide = math.sqrt(covariance[0, 0] + covariance[1, 1]) > 0.5
        count = self.most if wide else self.least
        noise = spread @ self.random.standard_normal((3, count))
        self.settle(np.asarray(mean, dtype=np.float64)[:, None] + noise)

    def settle(self, poses: Array) -> None:
        """Make `poses` (3, n) the cloud, equally weighted."""
        self.poses = np.array(poses, dtype=np.float64, order="C")
        self.log_weights = np.zeros(poses.shape[1])

    def move(self, step: Increment) -> None:
        """Move all poses by what odometry told."""
        move_cloud(self.poses, step, self.model, self.random)

    def fuse(self, log_likelihood: Callable[[Array], Array]) -> None:
        """Weigh all poses (3, n) by a log-likelihood (n,); resample if few of them are left."""
        weighed = self.log_weights + log_likelihood(self.poses)
        weights = normalized(weighed)
        share = 1.0 / (float(weights @ weights) * self.count)
        if share >= 0.5:
            self.log_weights = weighed - weighed.max()
        elif share >= _TOO_POOR:
            self._redraw(weights)
        else:
            rows = self.poses[:, None, :]
            weights = self.log_weights[None, :]
            narrow(rows, weights, lambda p, _: log_likelihood(p[:, 0])[None, :], self.random)

    def estimate(self) -> Estimate:
        """Mean and covariance."""
        return estimate(self.poses, self.log_weights)

    def sample(self, count: int, random: np.random.Generator) -> Array:
        """`count` equally weighted poses (3, count)."""
        chosen = systematic_choice(normalized(self.log_weights), count, random)
        drawn: Array = self.poses[:, chosen]
        return drawn

    def _redraw(self, weights: Array) -> None:
        count = min(self.most, max(self.least, kld_count(self.poses, weights)))
        drawn = redraw(self.poses, weights, 0.2, self.random, count)
        self.poses = np.ascontiguousarray(drawn)
        self.log_weights = np.zeros(count)


def kld_count(poses: Array, weights: Array) -> int:
    """How many poses the cloud needs so that it errs little: the bound of Fox 2003.

    From the number k of bins that poses (3, n) of weights (n,) lie in: n = (k - 1) / 2e (1 - 2 /
    9(k - 1) + z sqrt(2 / 9(k - 1)))^3 with error e and quantile z.
    """
    keys = np.empty(weights.size, np.int64)
    kept, span = _bins(np.ascontiguousarray(poses), weights, _BIN, 0.1 / weights.size, keys)
    # Up to so many bins it is quicker to count in all of them than to sort.
    if span <= _FEW_BINS:
        occupied = int(np.count_nonzero(np.bincount(keys[:kept])))
    else:
        occupied = np.unique(keys[:kept]).size
    if occupied < 2:
        return 0
    term = 2.0 / (9.0 * (occupied - 1))
    bound = (1.0 - term + math.sqrt(term) * _KLD_QUANTILE) ** 3
    return math.ceil((occupied - 1) / (2.0 * _KLD_ERROR) * bound)


@compiled(
    "Tuple((int64, float64))(float64[:, ::1], float64[::1], float64[::1], float64, int64[::1])"
)
def _bins(
    poses: Array, weights: Array, size: Array, least: float, keys: NDArray[np.int64]
) -> tuple[int, float]:
    """Keys of the bins of poses that weigh more than `least`; how many, and how many bins span
    them.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(weights.size):
        if weights[i] > least:
            for axis in range(3):
                low[axis] = min(low[axis], poses[axis, i])
                high[axis] = max(high[axis], poses[axis, i])
    first, spans = np.zeros(3), np.zeros(3)
    for axis in range(3):
        first[axis] = math.floor(low[axis] / size[axis])
        spans[axis] = math.floor(high[axis] / size[axis]) - first[axis] + 1.0
    count = 0
    for i in range(weights.size):
        if weights[i] > least:
            key = np.int64(0)
            for axis in range(3):
                place = math.floor(poses[axis, i] / size[axis]) - first[axis]
                key = key * np.int64(spans[axis]) + np.int64(place)
            keys[count] = key
            count += 1
    return count, spans[0] * spans[1] * spans[2]
