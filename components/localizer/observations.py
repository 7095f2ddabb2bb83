"""Observations of mapped objects: their likelihood, innovation, and association with landmarks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.particle_set import PoseEstimate
from cairn.planar.poses import Pose, wrap, wrap_all
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

NEAREST_M = 0.3
"""Objects nearer than this [m] count as so far away: no camera recognizes them, and bearings are
not linear in the position.
"""
# Log-density of a stray observation, which is unrelated to the object's position in the map,
# relative to the peak of the observation's own Gaussian: that of the 99 % quantile, -9.2 / 2.
STRAY = -4.6


@dataclass(frozen=True)
class Landmark:
    """An object of the visual map: position [m], its covariance [m^2], reliability, and whether
    it is live.
    """

    object_id: int
    x: float
    y: float
    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0
    reliability: float = 0.5
    live: bool = True


@dataclass(frozen=True)
class CameraView:
    """Where an object could have been recognized: bearings [rad, left positive], ranges [m]."""

    right: float
    left: float
    nearest: float
    farthest: float


def as_certain(landmark: Landmark) -> Landmark:
    """Return the landmark as if it certainly stood where the map says."""
    return replace(landmark, reliability=1.0)


def object_log_likelihood(
    poses: NDArray[np.float64], observation: Observation, landmark: Landmark
) -> NDArray[np.float64]:
    """Return log-weights (...) that `observation` adds to `poses` (3, ...).

    A mixture: with probability `reliability` the object stands where the map says and the
    observation is Gaussian in range and bearing; otherwise the observation is a stray of constant
    density. So no single observation can rule a pose out, except one of an object whose reliability
    is 1.
    """
    dx = landmark.x - poses[0]
    dy = landmark.y - poses[1]
    distance = np.sqrt(dx * dx + dy * dy)
    # The map's own uncertainty from here: isotropic is enough, as it is a few centimeters.
    spread = 0.5 * (landmark.xx + landmark.yy)
    range_variance = observation.range_variance + spread
    reach = max(observation.range_m, NEAREST_M)
    bearing_variance = observation.bearing_variance + spread / reach**2
    bearing_error = wrap_all(np.arctan2(dy, dx) - poses[2] - observation.bearing)
    nis = (
        distance - observation.range_m
    ) ** 2 / range_variance + bearing_error**2 / bearing_variance
    gaussian: NDArray[np.float64] = -0.5 * nis
    if landmark.reliability >= 1.0:
        return gaussian
    stray = (1.0 - landmark.reliability) * math.exp(STRAY)
    mixed: NDArray[np.float64] = np.log(landmark.reliability * np.exp(gaussian) + stray)
    return mixed


# Errors that no covariance states [m]: of surveyed positions in the map, and a floor for the pose.
# With a floor of 0.03 to 0.04 m objects were removed wrongly in simulation; one of 0.30 m detected
# only 22 % of moves by 0.5 m, one of 0.12 m 89 %.
MAP_SIGMA = 0.03
POSE_FLOOR = 0.12
# Outside this normalized innovation squared an observation contradicts a pose: the 99.9 % quantile
# of chi-square with 2 degrees of freedom, -2 ln(0.001) = 13.8.
GATE = 13.8


@dataclass(frozen=True)
class Innovation:
    """An observation against a prediction: normalized innovation squared, and the Gaussian's
    peak density [1/(m rad)].
    """

    nis: float
    peak: float

    @property
    def density(self) -> float:
        """The density at the observation; 0 far enough from the prediction."""
        return self.peak * math.exp(-0.5 * self.nis)


def innovation(pose: PoseEstimate, observation: Observation, landmark: Landmark) -> Innovation:
    """Return how far `observation` is from what `pose` predicts for `landmark` in range and
    bearing.
    """
    x, y, theta = pose.mean
    dx, dy = landmark.x - x, landmark.y - y
    distance = max(math.hypot(dx, dy), NEAREST_M)
    error = np.array(
        [
            observation.range_m - distance,
            wrap(observation.bearing - math.atan2(dy, dx) + theta),
        ]
    )
    by_position = np.array([[dx / distance, dy / distance], [-dy / distance**2, dx / distance**2]])
    jacobian = np.hstack([-by_position, [[0.0], [-1.0]]])
    position = np.array([[landmark.xx, landmark.xy], [landmark.xy, landmark.yy]])
    position += (MAP_SIGMA**2) * np.eye(2)
    covariance = pose.covariance + np.diag([POSE_FLOOR**2 / 2, POSE_FLOOR**2 / 2, 0.0])
    total = (
        jacobian @ covariance @ jacobian.T
        + by_position @ position @ by_position.T
        + np.diag([observation.range_variance, observation.bearing_variance])
    )
    nis = float(error @ np.linalg.solve(total, error))
    return Innovation(nis, 1.0 / (2.0 * math.pi * math.sqrt(float(np.linalg.det(total)))))


def implied_position(pose: PoseEstimate, observation: Observation) -> tuple[float, float, Array]:
    """Return where the observed object stands (x, y [m]) if the robot is at `pose`, and the
    covariance (2, 2).
    """
    x, y, theta = pose.mean
    direction = theta + observation.bearing
    cosine, sine = math.cos(direction), math.sin(direction)
    reach = observation.range_m
    by_pose = np.array([[1.0, 0.0, -reach * sine], [0.0, 1.0, reach * cosine]])
    by_sighting = np.array([[cosine, -reach * sine], [sine, reach * cosine]])
    noise = np.diag([observation.range_variance, observation.bearing_variance])
    covariance = by_pose @ pose.covariance @ by_pose.T + by_sighting @ noise @ by_sighting.T
    return x + reach * cosine, y + reach * sine, covariance


# One object must explain an observation better than another that looks alike by this NIS: a
# likelihood ratio of exp(6 / 2) = 20.
_CLEAR_NIS = 6.0


def associate(
    observations: Sequence[Observation],
    pose: PoseEstimate | None,
    landmarks: Mapping[int, Landmark],
) -> list[Observation]:
    """Return the observations whose object is certain, each under that object's identifier.

    An observation with alternatives is assigned to the one that stands where it was observed from
    `pose`; of several observations of one object in one image, the one at the object's position
    counts. This is not an assignment problem: what remains ambiguous is left out rather than
    assigned at the least total cost, as a wrong assignment moves the pose; without a pose, all of
    it is left out.
    """
    certain: list[Observation] = []
    for one in observations:
        names = (one.object_id, *one.alternatives)
        options = [replace(one, object_id=name, alternatives=()) for name in names]
        certain += options if len(options) == 1 else _clearest(options, pose, landmarks)
    kept: list[Observation] = []
    for object_id in dict.fromkeys(one.object_id for one in certain):
        instances = [one for one in certain if one.object_id == object_id]
        kept += instances if len(instances) == 1 else _clearest(instances, pose, landmarks)
    return kept


def _clearest(
    options: Iterable[Observation], pose: PoseEstimate | None, landmarks: Mapping[int, Landmark]
) -> list[Observation]:
    """Return the option that agrees with the map, if it does so clearly best; otherwise nothing."""
    if pose is None:
        return []
    live = [one for one in options if one.object_id in landmarks and landmarks[one.object_id].live]
    ranked = sorted(
        ((innovation(pose, one, landmarks[one.object_id]).nis, k) for k, one in enumerate(live))
    )
    if not ranked or ranked[0][0] > GATE:
        return []
    if len(ranked) > 1 and ranked[1][0] < ranked[0][0] + _CLEAR_NIS:
        return []
    return [live[ranked[0][1]]]


def as_observed_from(observation: Observation, step: Pose) -> Observation:
    """Return an observation as from the pose that lies at `step` [m, rad] from where it was made.

    A recognizer takes longer than a scan: its observations are older than the particles.
    """
    x, y, turn = step
    dx = observation.range_m * math.cos(observation.bearing) - x
    dy = observation.range_m * math.sin(observation.bearing) - y
    range_m = max(math.hypot(dx, dy), NEAREST_M)
    return replace(observation, range_m=range_m, bearing=wrap(math.atan2(dy, dx) - turn))


def view_as_from(view: CameraView, step: Pose) -> CameraView:
    """Return a camera's view likewise; while an observation is late, the robot hardly drives."""
    return replace(view, right=view.right - step[2], left=view.left - step[2])
