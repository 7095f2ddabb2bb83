"""Equation (1): how similar the pose that one object implies is to the robot's pose without it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.object_likelihood import Landmark, Sighting
from cairn.components.localizer.particles import Estimate
from cairn.planar.poses import wrap

Array = NDArray[np.float64]

# Equation (2) never comes back from 0 or 1, so neither does a similarity ever reach them.
LEAST, MOST, NEUTRAL = 0.1, 0.9, 0.5
# Density [1/(m rad)] of a sighting of an object that stands anywhere in view: 4 m by 60 degrees.
CLUTTER = 1.0 / (4.0 * math.radians(60.0))
# The map's and the pose's errors that no covariance speaks of [m].
MAP_SIGMA = 0.03
POSE_FLOOR = 0.12
# Outside this normalized innovation squared (2 dof, 99.9 %) a sighting contradicts a pose.
GATE = 13.8
ACCEPTED = 9.21  # inside this one (99 %) a gate takes it for granted


@dataclass(frozen=True)
class Innovation:
    """A sighting against a prediction: normalized innovation squared, and the Gaussian's density
    [1/(m rad)] where they meet exactly.
    """

    nis: float
    peak: float

    @property
    def density(self) -> float:
        """The density at the sighting; 0 far enough from the prediction."""
        return self.peak * math.exp(-0.5 * self.nis)


def innovation(pose: Estimate, sighting: Sighting, landmark: Landmark) -> Innovation:
    """How far `sighting` is from what `pose` predicts for `landmark` (range [m], bearing [rad])."""
    x, y, theta = pose.mean
    dx, dy = landmark.x - x, landmark.y - y
    distance = max(math.hypot(dx, dy), 0.05)
    error = np.array(
        [
            sighting.range_m - distance,
            wrap(sighting.bearing - math.atan2(dy, dx) + theta),
        ]
    )
    by_place = np.array([[dx / distance, dy / distance], [-dy / distance**2, dx / distance**2]])
    jacobian = np.hstack([-by_place, [[0.0], [-1.0]]])
    place = np.array([[landmark.xx, landmark.xy], [landmark.xy, landmark.yy]])
    place += (MAP_SIGMA**2) * np.eye(2)
    covariance = pose.covariance + np.diag([POSE_FLOOR**2 / 2, POSE_FLOOR**2 / 2, 0.0])
    total = (
        jacobian @ covariance @ jacobian.T
        + by_place @ place @ by_place.T
        + np.diag([sighting.range_variance, sighting.bearing_variance])
    )
    nis = float(error @ np.linalg.solve(total, error))
    return Innovation(nis, 1.0 / (2.0 * math.pi * math.sqrt(float(np.linalg.det(total)))))


def likelihood_ratio_similarity(seen: Innovation) -> float:
    """Mode "lr": odds of "stands where the map says" against "stands anywhere in view".

    A prediction too vague to beat clutter even when met exactly says nothing: neutral.
    """
    if seen.peak < 4.0 * CLUTTER:
        return NEUTRAL
    return clamp(seen.density / (seen.density + CLUTTER))


def paper_similarity(radius: float, distance: float) -> float:
    """Mode "paper": equation (1), r / d, 1 inside the bound; clamped. Both in meters."""
    return clamp(min(1.0, radius / max(distance, 1e-6)))


def gate_similarity(seen: Innovation) -> float:
    """Mode "chi_square": inside 99 % of the prediction it agrees, outside 99.9 % it does not."""
    if seen.nis <= ACCEPTED:
        return MOST
    return LEAST if seen.nis > GATE else NEUTRAL


def similarity_to_the_letter(radius: float, distance: float) -> float:
    """Mode "letter": equation (1) as the paper has it, from 0 to 1; 1 for no distance at all."""
    return 1.0 if distance <= radius else radius / distance


def radius_to_the_letter(pose: Estimate) -> float:
    """r of equation (1) [m] as two standard deviations of the cloud, however small it is."""
    longest = float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
    return 2.0 * math.sqrt(max(longest, 0.0))


def clamp(similarity: float) -> float:
    """A similarity within [0.1, 0.9]."""
    return min(MOST, max(LEAST, similarity))


def convergence_radius(pose: Estimate) -> float:
    """r of equation (1) [m]: 95 % of the cloud along its longest axis, at least 0.12 m."""
    longest = float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
    return max(POSE_FLOOR, 2.45 * math.sqrt(max(longest, 0.0)))


def implied_place(pose: Estimate, sighting: Sighting) -> tuple[float, float, Array]:
    """Where the sighted object stands (x, y [m]) if the robot is at `pose`; covariance (2, 2)."""
    x, y, theta = pose.mean
    direction = theta + sighting.bearing
    cosine, sine = math.cos(direction), math.sin(direction)
    reach = sighting.range_m
    by_pose = np.array([[1.0, 0.0, -reach * sine], [0.0, 1.0, reach * cosine]])
    by_sighting = np.array([[cosine, -reach * sine], [sine, reach * cosine]])
    noise = np.diag([sighting.range_variance, sighting.bearing_variance])
    covariance = by_pose @ pose.covariance @ by_pose.T + by_sighting @ noise @ by_sighting.T
    return x + reach * cosine, y + reach * sine, covariance
