"""The particle set: weighted poses, their statistics, resampling, and tempered updates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.odometry import move_particles
from cairn.components.localizer.pose_differences import place_bin
from cairn.planar.compiled import compiled
from cairn.planar.motion_model import MotionModel, OdometryStep
from cairn.planar.poses import Pose

Array = NDArray[np.float64]

# The error of the distribution by the KLD bound is 2 % with a probability of 99 %.
_KLD_ERROR, _KLD_QUANTILE = 0.02, NormalDist().inv_cdf(0.99)
# With a smaller share of effective particles they are resampled (Grisetti, Stachniss, Burgard
# 2007).
_EFFECTIVE = 0.5
# Kernel width of resampling as a share of the particles' deviation. Liu and West 2001 recommend
# discounts of 0.95 to 0.99, which are widths of 0.23 to 0.10.
_BANDWIDTH = 0.2
# A likelihood is fused in at most so many stages, whose shares are found by as many halvings: 1/256
# of a log-likelihood. While a robot is tracked, one in so many particles must stay effective.
_STAGES = 8


@dataclass(frozen=True)
class PoseEstimate:
    """Mean pose (x [m], y [m], theta [rad]) and covariance (3, 3) of a particle set."""

    mean: tuple[float, float, float]
    covariance: Array

    @property
    def spread(self) -> float:
        """The standard deviation of the position [m]: the root of the trace of its covariance."""
        return math.sqrt(max(0.0, float(self.covariance[0, 0] + self.covariance[1, 1])))

    @property
    def widest(self) -> float:
        """The largest standard deviation of the position in any direction [m]."""
        xx, yy, xy = self.covariance[0, 0], self.covariance[1, 1], self.covariance[0, 1]
        return math.sqrt(max(0.0, 0.5 * float(xx + yy + math.hypot(xx - yy, 2.0 * xy))))


class ParticleSet:
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
        """The number of particles."""
        return self.log_weights.size

    def set_gaussian(self, mean: Sequence[float], covariance: Array) -> None:
        """Draw all particles from a Gaussian over x [m], y [m], theta [rad]."""
        drawn = gaussian_noise(covariance, self.most, self.random)
        drawn += np.asarray(mean, dtype=np.float64)[:, None]
        self.set_particles(drawn[:, : self._due(drawn)])

    def set_particles(self, poses: Array) -> None:
        """Replace the particles by `poses` (3, n), with equal weights."""
        self.poses = np.array(poses, dtype=np.float64, order="C")
        self.log_weights = np.zeros(poses.shape[1])

    def move(self, step: OdometryStep) -> None:
        """Move all particles by a step of odometry, each with its own noise."""
        move_particles(self.poses, step, self.model, self.random)

    def fuse(self, log_likelihood: Callable[[Array], Array]) -> None:
        """Multiply the weights by a likelihood; resample if it leaves few effective particles.

        `log_likelihood` returns (n,) for poses (3, n).
        """
        resampled = tempered_update(
            self.poses[:, None],
            self.log_weights[None],
            lambda poses, _: log_likelihood(poses[:, 0])[None],
            self.random,
            1.0 / _STAGES,
        )
        if resampled and (due := self._due(self.poses)) != self.count:
            weights = normalized(self.log_weights)
            self.set_particles(resample(self.poses, weights, self.random, due))

    def estimate(self) -> PoseEstimate:
        """Return mean and covariance."""
        return estimate(self.poses, self.log_weights)

    def sample(self, count: int, random: np.random.Generator) -> Array:
        """Return `count` equally weighted poses (3, count)."""
        chosen = systematic_choice(normalized(self.log_weights), count, random)
        drawn: Array = self.poses[:, chosen]
        return drawn

    def _due(self, drawn: Array) -> int:
        """Return how many particles represent a distribution, of which poses (3, n) are drawn."""
        return min(self.most, max(self.least, kld_count(drawn)))


def gaussian_noise(covariance: Array, count: int, random: np.random.Generator) -> Array:
    """Return noise (3, count) of a covariance (3, 3), which may be singular."""
    drawn = random.multivariate_normal(np.zeros(3), covariance, count, check_valid="ignore")
    return np.ascontiguousarray(drawn.T)


def kld_count(drawn: Array) -> int:
    """Return how many particles bound the error of their distribution (KLD sampling, Fox 2003).

    From the number k of places that poses (3, n), drawn from it, occupy: n = (k - 1) / 2e (1 - 2 /
    9(k - 1) + z sqrt(2 / 9(k - 1)))^3 with error e and quantile z.
    """
    bins = np.floor(drawn / place_bin()[:, None]).astype(np.int64)
    bins -= bins.min(axis=1, keepdims=True)
    spans = bins.max(axis=1) + 1
    occupied = np.unique((bins[0] * spans[1] + bins[1]) * spans[2] + bins[2]).size
    if occupied < 2:
        return 0
    term = 2.0 / (9.0 * (occupied - 1))
    bound = (1.0 - term + math.sqrt(term) * _KLD_QUANTILE) ** 3
    return math.ceil((occupied - 1) / (2.0 * _KLD_ERROR) * bound)


def normalized(log_weights: Array) -> Array:
    """Return weights (..., n) that sum to one over the last axis."""
    weights: Array = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
    weights /= weights.sum(axis=-1, keepdims=True)
    return weights


def estimate(poses: Array, log_weights: Array) -> PoseEstimate:
    """Return weighted mean and covariance of `poses` (3, n); the mean heading is circular."""
    return _moments_of(np.ascontiguousarray(poses), normalized(log_weights))


def effective_count(log_weights: Array) -> Array:
    """Return Kish's effective number of samples over the last axis of `log_weights` (..., n)."""
    weights = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
    result: Array = weights.sum(axis=-1) ** 2 / (weights * weights).sum(axis=-1)
    return result


def systematic_choice(weights: Array, count: int, random: np.random.Generator) -> NDArray[np.intp]:
    """Return indices (count,) drawn by systematic resampling: i on average count * weights[i]
    times.

    `weights` (n,) sum to one. One random number, O(n); Kitagawa 1996.
    """
    chosen = np.empty(count, np.int64)
    _choose(np.ascontiguousarray(weights), float(weights.sum()), random.random(), chosen)
    return chosen


def resample(
    poses: Array, weights: Array, random: np.random.Generator, count: int | None = None
) -> Array:
    """Return `count` new poses (3, count) drawn from weighted ones (3, n); by default n.

    Each drawn pose is pulled toward the mean by sqrt(1 - h^2) and moved by h times the covariance
    of the drawn poses, with h = `_BANDWIDTH` (Liu and West 2001): copies differ, while mean and
    covariance do not change.
    """
    count = poses.shape[1] if count is None else count
    drawn = np.ascontiguousarray(poses[:, systematic_choice(weights, count, random)])
    drawn_moments = _moments_of(drawn, np.full(count, 1.0 / count))
    root = np.zeros((3, 3))
    _root(drawn_moments.covariance, root)
    # Only the covariance of the kernel matters; a uniform one takes a third of the time to draw.
    noise = math.sqrt(12.0) * (random.random((3, count)) - 0.5)
    _kernel(drawn, noise, *drawn_moments.mean, root, _BANDWIDTH)
    return drawn


def tempered_update(
    poses: Array,
    log_weights: Array,
    log_likelihood: Callable[[Array, NDArray[np.intp]], Array],
    random: np.random.Generator,
    kept: float = _EFFECTIVE,
) -> bool:
    """Fuse a log-likelihood into particle sets `poses` (3, rows, n), `log_weights` (rows, n), in
    place. Return whether any was resampled.

    `log_likelihood` returns (k, n) for the poses (3, k, n) of the rows with the numbers (k,). A row
    of which fewer than half of the particles are effective then is resampled. Where the likelihood
    would leave less than the share `kept`, it is fused in stages, each followed by resampling
    (progressive correction: Musso, Oudjane, Le Gland 2001), so that a few hundred particles
    survive the first observation after a long time without any. With a share of an eighth, one of
    two places that look alike is lost at times; with half, both stay.
    """
    rows = np.arange(log_weights.shape[0])
    left = np.ones(rows.size)
    is_resampled = False
    for stage in range(_STAGES):
        added = log_likelihood(poses[:, rows], rows)
        share = left[rows]
        if stage < _STAGES - 1:
            share = _shares(log_weights[rows], added, share, kept)
        log_weights[rows] += share[:, None] * added
        left[rows] -= share
        thin = effective_count(log_weights[rows]) < _EFFECTIVE * added.shape[1]
        for row in rows[thin | (left[rows] > 0.0)]:
            poses[:, row] = resample(poses[:, row], normalized(log_weights[row]), random)
            log_weights[row] = 0.0
            is_resampled = True
        if not (rows := rows[left[rows] > 0.0]).size:
            break
    log_weights -= log_weights.max(axis=1, keepdims=True)
    return is_resampled


def _shares(log_weights: Array, added: Array, left: Array, kept: float) -> Array:
    """Return the largest share (by halving) of what is left that leaves enough effective."""
    share = left.copy()
    for _ in range(_STAGES):
        thin = effective_count(log_weights + added * share[:, None]) < kept * added.shape[1]
        if not thin.any():
            break
        share[thin] *= 0.5
    return share


@compiled("void(float64[::1], float64, float64, int64[::1])")
def _choose(weights: Array, total: float, begin: float, chosen: NDArray[np.int64]) -> None:
    last, count = weights.size - 1, chosen.size
    index, reached = 0, weights[0]
    for k in range(count):
        point = (k + begin) * (total / count)
        while reached <= point and index < last:
            index += 1
            reached += weights[index]
        chosen[k] = index


@compiled()
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


def _moments_of(poses: Array, weights: Array) -> PoseEstimate:
    mean, covariance = np.empty(3), np.empty((3, 3))
    _moments(poses, weights, mean, covariance)
    return PoseEstimate((float(mean[0]), float(mean[1]), float(mean[2])), covariance)


@compiled("void(float64[:, ::1], float64[::1], float64[::1], float64[:, ::1])")
def _moments(poses: Array, weights: Array, mean: Array, covariance: Array) -> None:
    x = y = ahead = aside = 0.0
    first = poses[2, 0]
    for i in range(poses.shape[1]):
        x += weights[i] * poses[0, i]
        y += weights[i] * poses[1, i]
        ahead += weights[i] * math.cos(poses[2, i] - first)
        aside += weights[i] * math.sin(poses[2, i] - first)
    turned = math.atan2(aside, ahead)
    mean[0], mean[1], mean[2] = x, y, _wrapped(first + turned)
    xx = xy = yy = xt = yt = tt = 0.0
    for i in range(poses.shape[1]):
        dx, dy = poses[0, i] - x, poses[1, i] - y
        turn = _wrapped(poses[2, i] - mean[2])
        xx += weights[i] * dx * dx
        xy += weights[i] * dx * dy
        yy += weights[i] * dy * dy
        xt += weights[i] * dx * turn
        yt += weights[i] * dy * turn
        tt += weights[i] * turn * turn
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = xx, yy, tt
    covariance[0, 1] = covariance[1, 0] = xy
    covariance[0, 2] = covariance[2, 0] = xt
    covariance[1, 2] = covariance[2, 1] = yt


@compiled("void(float64[:, ::1], float64[:, ::1])")
def _root(covariance: Array, root: Array) -> None:
    """Compute Cholesky's lower triangle of a covariance (3, 3)."""
    for i in range(3):
        for j in range(i + 1):
            rest = covariance[i, j]
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i == j:
                root[i, j] = math.sqrt(max(rest, 0.0))
            elif root[j, j] > 0.0:
                root[i, j] = rest / root[j, j]


@compiled(
    "void(float64[:, ::1], float64[:, ::1], float64, float64, float64, float64[:, ::1], float64)"
)
def _kernel(
    poses: Array,
    noise: Array,
    x: float,
    y: float,
    theta: float,
    root: Array,
    bandwidth: float,
) -> None:
    """Pull poses toward the mean and move them by `root` @ `noise`, in place."""
    shrink = math.sqrt(1.0 - bandwidth**2)
    for i in range(poses.shape[1]):
        turn = _wrapped(poses[2, i] - theta)
        a, b, c = bandwidth * noise[0, i], bandwidth * noise[1, i], bandwidth * noise[2, i]
        poses[0, i] = x + shrink * (poses[0, i] - x) + root[0, 0] * a
        poses[1, i] = y + shrink * (poses[1, i] - y) + root[1, 0] * a + root[1, 1] * b
        poses[2, i] = theta + shrink * turn + root[2, 0] * a + root[2, 1] * b + root[2, 2] * c


def carry(poses: Array, step: Pose) -> Array:
    """Return poses (3, n) after the relative motion `step`."""
    cosine, sine = np.cos(poses[2]), np.sin(poses[2])
    return np.stack(
        [
            poses[0] + step[0] * cosine - step[1] * sine,
            poses[1] + step[0] * sine + step[1] * cosine,
            poses[2] + step[2],
        ]
    )
