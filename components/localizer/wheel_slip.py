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
from cairn.components.localizer.scan_fit import usual_fit
from cairn.planar.poses import Pose, compose, distance, relative, wrap

Array = NDArray[np.float64]

# How far a slip moves the robot from its odometry: standard deviations [m], [m], [rad]. A robot at
# 0.6 m/s that is held for half a second is 0.3 m off. Half and double change the median error on
# the logs fr101 and fr079 by at most 1 mm; slips themselves were not compared.
_SLIP = np.array([[0.35], [0.35], [0.3]])
# Poses drawn around the current one; a third of them is kept in each round of annealing, with the
# share of the log-likelihood that counts and the noise added [m], [rad]. 500 poses remain, as many
# as the localizer's particles. Chosen by hand; `lab/constants.yaml` has the effect of half
# and double.
_POSES = 1500
_ANNEALING = ((0.25, 0.05), (0.5, 0.03), (1.0, 0.02))
# A scan of which the map explains this share or more does not indicate a slip. Chosen by hand;
# `lab/constants.yaml` has the effect of half and double.
_GOOD_FIT = 0.8
# Another pose must explain this share of the beams more, and explain the scan better by this
# log-likelihood [nats], as much as relocalization demands. The share was chosen by hand;
# `lab/constants.yaml` has the effect of half and double.
_BETTER_FIT, _BETTER_NATS = 0.12, 6.0
# It must fit at least this share as well as scans did before; otherwise the robot was carried away.
# Chosen by hand; `lab/constants.yaml` has the effect of half and double.
_OF_USUAL_FIT = 0.9
# The poses found by two scans are the same if they differ by less than this [m], [rad]; particles
# spread wider than this [m] are not one pose. About one deviation of a slip (`_SLIP`). Chosen by
# hand; `lab/constants.yaml` has the effect of half and double.
_SAME_M, _SAME_RAD, _WIDEST_M = 0.3, 0.2, 0.3


class WheelSlipDetector:
    """Searches around the pose whenever a scan fits badly, and believes two scans that agree.

    The motion model covers errors that accumulate slowly. Wheels that spin, or a robot that is
    pushed, are off by many times as much at once, and then no particle is right.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self.random = random
        # The pose that the last scan suggested, and the dead-reckoned pose of that time.
        self._suspected: tuple[Pose, Pose] | None = None
        self._usual_fit: float | None = None

    def reset(self) -> None:
        """Forget what was suspected and how well scans fit: the robot is somewhere else."""
        self._suspected = self._usual_fit = None

    def detect(
        self,
        here: PoseEstimate,
        points: Array,
        field: LikelihoodField,
        share: float,
        reckoned: Pose,
    ) -> Array | None:
        """Return poses (3, n) that explain a scan much better than the current one.

        Args:
            here: The current pose.
            points: End points (m, 2) [m] of the scan's beams, in the frame of the base.
            field: The likelihood field of the grid map.
            share: The share of a scan's log-likelihood that counts.
            reckoned: The dead-reckoned pose now.

        Returns:
            None if there are none, or as long as only one scan suggests them.

        """
        fit = field.fit(here.mean, points)
        before, self._suspected = self._suspected, None
        usual = fit if self._usual_fit is None else self._usual_fit
        self._usual_fit = usual_fit(usual, fit)
        if fit >= _GOOD_FIT:
            return None
        center = np.asarray(here.mean)[:, None]
        poses = center + _SLIP * self.random.standard_normal((3, _POSES))
        for temper, noise in _ANNEALING:
            weights = normalized(temper * share * field.log_likelihood(poses, points))
            poses = poses[:, systematic_choice(weights, _POSES // 3, self.random)]
            poses += noise * self.random.standard_normal(poses.shape)
        found = estimate(poses, np.zeros(poses.shape[1]))
        least = max(fit + _BETTER_FIT, _OF_USUAL_FIT * usual)
        if found.spread > _WIDEST_M or field.fit(found.mean, points) < least:
            return None
        both = np.column_stack((found.mean, here.mean))
        there, current = share * field.log_likelihood(both, points)
        # The farther away, the less likely a slip is.
        slip = ((both[:, :1] - center) / _SLIP).ravel()
        slip[2] = wrap(found.mean[2] - here.mean[2]) / _SLIP[2, 0]
        if there - 0.5 * float(slip @ slip) < current + _BETTER_NATS:
            return None
        self._suspected = (found.mean, reckoned)
        if before is None:
            return None
        expected = compose(before[0], relative(before[1], reckoned))
        same = distance(expected, found.mean) < _SAME_M
        same = same and abs(wrap(expected[2] - found.mean[2])) < _SAME_RAD
        return poses if same else None
