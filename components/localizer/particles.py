"""Clouds of weighted poses: their statistics, resampling and careful narrowing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.localizer.object_likelihood import wrap

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """Mean pose (x [m], y [m], theta [rad]) and covariance (3, 3) of a cloud."""

    mean: tuple[float, float, float]
    covariance: Array

    @property
    def spread(self) -> float:
        """Standard deviation of the position [m]: sqrt of the trace of its covariance."""
        return math.sqrt(max(0.0, float(self.covariance[0, 0] + self.covariance[1, 1])))


def normalised(log_weights: Array) -> Array:
    """Weights (..., n) that sum to one over the last axis."""
    weights: Array = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
    weights /= weights.sum(axis=-1, keepdims=True)
    return weights


def estimate(poses: Array, log_weights: Array) -> Estimate:
    """Weighted mean and covariance of `poses` (3, n); the heading's mean is circular."""
    weights = normalised(log_weights)
    x = float(weights @ poses[0])
    y = float(weights @ poses[1])
    theta = math.atan2(float(weights @ np.sin(poses[2])), float(weights @ np.cos(poses[2])))
    offset = np.empty_like(poses)
    offset[0] = poses[0] - x
    offset[1] = poses[1] - y
    offset[2] = wrap(poses[2] - theta)
    return Estimate((x, y, theta), (offset * weights) @ offset.T)


def effective_count(log_weights: Array) -> Array:
    """Kish's effective number of samples over the last axis of `log_weights` (..., n)."""
    weights = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
    result: Array = weights.sum(axis=-1) ** 2 / (weights * weights).sum(axis=-1)
    return result


def systematic_choice(weights: Array, count: int, random: np.random.Generator) -> NDArray[np.intp]:
    """Indices (count,) drawn by systematic resampling: each i count * weights[i] times on average.

    `weights` (n,) sum to one. One random number, O(n); Kitagawa 1996.
    """
    cumulative = np.cumsum(weights)
    points = (np.arange(count) + random.random()) * (cumulative[-1] / count)
    chosen: NDArray[np.intp] = np.searchsorted(cumulative, points, side="right")
    return np.minimum(chosen, weights.size - 1, out=chosen)


def redraw(
    poses: Array,
    weights: Array,
    bandwidth: float,
    random: np.random.Generator,
    count: int | None = None,
) -> Array:
    """`count` new poses (3, count) drawn from weighted ones (3, n), as many if it is not given.

    They are spread by a kernel that keeps mean and covariance.

    Each chosen sample is drawn in towards the mean by sqrt(1 - h^2) and moved by h times the
    cloud's own covariance (Liu and West 2001), so copies differ and the spread is unchanged.
    """
    count = poses.shape[1] if count is None else count
    chosen = poses[:, systematic_choice(weights, count, random)]
    theta = math.atan2(float(np.sin(chosen[2]).mean()), float(np.cos(chosen[2]).mean()))
    centre = np.array([chosen[0].mean(), chosen[1].mean(), theta])[:, None]
    offset = chosen - centre
    offset[2] = wrap(offset[2])
    covariance = offset @ offset.T / count + np.diag([1e-6, 1e-6, 1e-8])
    noise = np.linalg.cholesky(covariance) @ random.standard_normal((3, count))
    drawn: Array = centre + math.sqrt(1.0 - bandwidth**2) * offset + bandwidth * noise
    return drawn


def narrow(
    poses: Array,
    log_weights: Array,
    log_likelihood: Callable[[Array], Array],
    random: np.random.Generator,
    bandwidth: float = 0.25,
    rounds: int = 8,
) -> Array:
    """Fuse a log-likelihood into clouds `poses` (3, rows, n), `log_weights` (rows, n), in place.

    Where the likelihood would leave fewer than half of a row's samples effective, it is taken
    in stages, each followed by a redraw (progressive correction: Musso, Oudjane, Le Gland 2001),
    so that a few hundred samples survive the first sighting after a long blind stretch.
    Returns the log-evidence (rows,): log of the mean likelihood under the weights before.
    """
    rows, count = log_weights.shape
    contribution = log_likelihood(poses)
    evidence = _log_mean(log_weights, contribution)
    left = np.ones(rows)
    for stage in range(rounds):
        full = log_weights + contribution * left[:, None]
        poor = effective_count(full) < 0.5 * count
        if stage == rounds - 1 or not poor.any():
            log_weights[:] = full - full.max(axis=1, keepdims=True)
            break
        share = _shares(log_weights, contribution, left, poor)
        staged = log_weights + contribution * share[:, None]
        weights = normalised(staged)
        for row in np.nonzero(poor)[0]:
            poses[:, row] = redraw(poses[:, row], weights[row], bandwidth, random)
            log_weights[row] = 0.0
        left = np.where(poor, left - share, left)
        contribution = log_likelihood(poses)
    return evidence


def _shares(log_weights: Array, contribution: Array, left: Array, poor: NDArray[np.bool_]) -> Array:
    """Largest share (by halving) of what is left that keeps 30 % of the samples effective."""
    count = log_weights.shape[1]
    share = left.copy()
    for _ in range(6):
        thin = effective_count(log_weights + contribution * share[:, None]) < 0.3 * count
        thin &= poor
        if not thin.any():
            break
        share[thin] *= 0.5
    return share


def _log_mean(log_weights: Array, contribution: Array) -> Array:
    weights = normalised(log_weights)
    peak = contribution.max(axis=1)
    mean = (weights * np.exp(contribution - peak[:, None])).sum(axis=1)
    result: Array = np.log(np.maximum(mean, 1e-300)) + peak
    return result
