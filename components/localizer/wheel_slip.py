"""Detects wheels that slipped or were held: the robot is near, but not where odometry says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.particle_set import (
    PoseEstimate,
    estimate,
    normalized,
    systematic_choice,
)
from cairn.planar.poses import Pose, compose, distance, relative, wrap

Array = NDArray[np.float64]

# How far a slip leads astray: deviations [m], [m], [rad].
_ASTRAY = np.array([[0.35], [0.35], [0.3]])
_POSES = 1500
_ANNEALING = ((0.25, 0.05), (0.5, 0.03), (1.0, 0.02))
# A scan that fits no worse than this is no reason to look.
_GOOD = 0.8
# So much more of the scan must fit another pose, and by so much [nats] it must explain it better.
_FITS_BETTER, _BETTER = 0.12, 6.0
# It must fit nearly as well as scans did before, else the robot was carried off altogether.
_AS_BEFORE = 0.9
# Share of the newest scan in how well they usually fit; of one that fits worse than 0.8 of that,
# less: a carried robot is not to get used to its wrong place.
_NEWEST, _NEWEST_OF_BAD = 0.02, 0.001


class WheelSlipDetector:
    """Looks around the pose whenever a scan fits badly, and believes two scans that agree.

    The motion model holds errors that add up by and by. Wheels that spin, or a robot that is
    pushed, are off at once by many times as much, and then no pose of the cloud is right.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self.random = random
        self._guess: tuple[Pose, Pose] | None = None  # and the dead-reckoned pose of that time
        self._usual: float | None = None

    def forget(self) -> None:
        """Drop what was suspected and how well scans fit: the robot is somewhere else."""
        self._guess = self._usual = None

    def look(
        self,
        here: PoseEstimate,
        points: Array,
        field: LikelihoodField,
        share: float,
        reckoned: Pose,
    ) -> Array | None:
        """Poses (3, n) that explain a scan's end points (m, 2) much better than `here` does.

        `share` of a scan's log-likelihood counts; `reckoned` is the dead-reckoned pose now.
        None if there are none, or as long as only one scan tells of them.
        """
        fit = field.fit(here.mean, points)
        guess, self._guess = self._guess, None
        usual = fit if self._usual is None else self._usual
        self._usual = usual + (_NEWEST if fit >= 0.8 * usual else _NEWEST_OF_BAD) * (fit - usual)
        if fit >= _GOOD:
            return None
        center = np.asarray(here.mean)[:, None]
        poses = center + _ASTRAY * self.random.standard_normal((3, _POSES))
        for temper, jitter in _ANNEALING:
            weights = normalized(temper * share * field.log_likelihood(poses, points))
            poses = poses[:, systematic_choice(weights, _POSES // 3, self.random)]
            poses += jitter * self.random.standard_normal(poses.shape)
        found = estimate(poses, np.zeros(poses.shape[1]))
        least = max(fit + _FITS_BETTER, _AS_BEFORE * usual)
        if found.spread > 0.3 or field.fit(found.mean, points) < least:
            return None
        both = np.column_stack((found.mean, here.mean))
        score, before = share * field.log_likelihood(both, points)
        # The farther, the less likely a slip is.
        away = ((both[:, :1] - center) / _ASTRAY).ravel()
        away[2] = wrap(found.mean[2] - here.mean[2]) / _ASTRAY[2, 0]
        if score - 0.5 * float(away @ away) < before + _BETTER:
            return None
        self._guess = (found.mean, reckoned)
        if guess is None:
            return None
        expected = compose(guess[0], relative(guess[1], reckoned))
        apart = distance(expected, found.mean)
        return poses if apart < 0.3 and abs(wrap(expected[2] - found.mean[2])) < 0.2 else None
