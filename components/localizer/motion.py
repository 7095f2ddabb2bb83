"""How odometry moves a cloud of poses: the motion it tells, and the noise that it does not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose, compose

Poses = NDArray[np.float64]


@dataclass(frozen=True)
class MotionModel:
    """Random walk of the base about the motion that odometry tells.

    `forward_noise` [m/sqrt(s)] and `turn_noise` [rad/sqrt(s)] while it moves; `forward_slip`
    [m/sqrt(m)], `turn_slip` [rad/sqrt(rad)] and `turn_per_meter` [rad/sqrt(m)] per motion.
    Sideways it slips as it does ahead.
    """

    forward_noise: float = 0.025
    turn_noise: float = 0.04
    forward_slip: float = 0.016
    turn_slip: float = 0.03
    turn_per_meter: float = 0.0

    def deviations(self, step: Increment) -> tuple[float, float, float]:
        """Standard deviations of a step: ahead [m], to the left [m], of the turn [rad]."""
        far = math.hypot(step.ahead, step.aside)
        turned = abs(step.turned)
        ahead = self.forward_noise**2 * step.moving_s + self.forward_slip**2 * far
        turn = (
            self.turn_noise**2 * step.moving_s
            + self.turn_slip**2 * turned
            + self.turn_per_meter**2 * far
        )
        aside = self.forward_slip**2 * far if step.measured else 0.0
        return math.sqrt(ahead), math.sqrt(aside), math.sqrt(turn)


@dataclass(frozen=True)
class Increment:
    """Motion over a stretch of time, along the middle heading: meters ahead and to the left,
    radians to the left, seconds in motion; `measured` by the wheels, or only commanded.
    """

    ahead: float
    aside: float
    turned: float
    moving_s: float
    measured: bool = True


def move_pose(pose: Pose, step: Increment) -> Pose:
    """The expected pose after `step`: a chord in the direction of the middle heading."""
    x, y, theta = pose
    chord = theta + 0.5 * step.turned
    cosine, sine = math.cos(chord), math.sin(chord)
    return (
        x + step.ahead * cosine - step.aside * sine,
        y + step.ahead * sine + step.aside * cosine,
        theta + step.turned,
    )


def step_of(relative: Pose) -> Increment:
    """The increment that leads to `relative`, a pose seen from where the step began."""
    back = -0.5 * relative[2]
    ahead, aside, _ = compose((0.0, 0.0, back), relative)
    moved = relative != (0.0, 0.0, 0.0)
    return Increment(ahead, aside, relative[2], 1.0 if moved else 0.0)


def move_cloud(
    poses: Poses, step: Increment, model: MotionModel, random: np.random.Generator
) -> None:
    """Move every pose of the contiguous `poses` (3, ...) in place by `step`, each with noise."""
    if step.moving_s <= 0.0:
        return
    flat = poses.reshape(3, -1)
    noise = random.standard_normal(flat.shape)
    _move(flat, noise, step.ahead, step.aside, step.turned, *model.deviations(step))


@compiled(
    "void(float64[:, ::1], float64[:, ::1], float64, float64, float64, float64, float64, float64)"
)
def _move(
    poses: Poses,
    noise: Poses,
    ahead: float,
    aside: float,
    turned: float,
    ahead_sd: float,
    aside_sd: float,
    turn_sd: float,
) -> None:
    for i in range(poses.shape[1]):
        far = ahead + ahead_sd * noise[0, i]
        left = aside + aside_sd * noise[1, i]
        turn = turned + turn_sd * noise[2, i]
        chord = poses[2, i] + 0.5 * turn
        cosine, sine = math.cos(chord), math.sin(chord)
        poses[0, i] += far * cosine - left * sine
        poses[1, i] += far * sine + left * cosine
        poses[2, i] += turn
