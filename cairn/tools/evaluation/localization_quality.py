"""How near told poses are to the truth, and how honest their covariance is."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose
from cairn.tools.evaluation.results import ERROR_STEP_M

# Of a Gaussian in two dimensions 68.3, 95.4 and 99.7 % lie within these NIS.
SIGMAS = (2.296, 6.180, 11.829)


class LocalizationQuality:
    """Gathers errors [m] and normalized errors squared of the position."""

    def __init__(self) -> None:
        self.errors: list[float] = []
        self._nis: list[float] = []

    def add(self, told: Pose, covariance: NDArray[np.float64], true: Pose) -> None:
        """Take a pose as told, with its covariance (3, 3), and the true one."""
        error = np.array([told[0] - true[0], told[1] - true[1]])
        self.errors.append(math.hypot(*error))
        place = covariance[:2, :2]
        # One that is none states no error at all, and the truth is never within that.
        sound = np.linalg.det(place) > 0 and np.trace(place) > 0
        self._nis.append(float(error @ np.linalg.solve(place, error)) if sound else math.inf)

    def percentile(self, percent: float) -> float | None:
        """Percentile of the errors [m]; None without any."""
        return float(np.percentile(self.errors, percent)) if self.errors else None

    def counts(self) -> dict[int, int]:
        """How many poses had an error of so many `ERROR_STEP_M`."""
        return dict(sorted(Counter(round(error / ERROR_STEP_M) for error in self.errors).items()))

    def within(self) -> tuple[float, float, float] | None:
        """Shares of the poses whose truth lay within 1, 2, 3 standard deviations."""
        if not self._nis:
            return None
        nis = np.array(self._nis)
        one, two, three = (round(float(np.mean(nis <= limit)), 4) for limit in SIGMAS)
        return one, two, three
