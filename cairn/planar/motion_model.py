"""Motion between two times as odometry states it, and its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from cairn.planar.poses import Pose, compose


@dataclass(frozen=True)
class MotionModel:
    """Random walk of the base around the motion that odometry states.

    `forward_noise` [m/sqrt(s)] and `turn_noise` [rad/sqrt(s)] apply while it moves; `forward_slip`
    [m/sqrt(m)], `turn_slip` [rad/sqrt(rad)] and `turn_per_meter` [rad/sqrt(m)] per motion. Sideways
    slip equals forward slip.
    """

    forward_noise: float = 0.025
    turn_noise: float = 0.04
    forward_slip: float = 0.016
    turn_slip: float = 0.03
    turn_per_meter: float = 0.0

    def deviations(self, step: OdometryStep) -> tuple[float, float, float]:
        """Return standard deviations of a step: forward [m], left [m], turn [rad]."""
        far = math.hypot(step.ahead, step.aside)
        turned = abs(step.turned)
        ahead = self.forward_noise**2 * step.moving_s + self.forward_slip**2 * far
        turn = (
            self.turn_noise**2 * step.moving_s
            + self.turn_slip**2 * turned
            + self.turn_per_meter**2 * far
        )
        aside = self.forward_slip**2 * far if step.measured else 0.0
        times = step.uncertain
        forward = math.hypot(times * math.sqrt(ahead), step.gain_m)
        return forward, times * math.sqrt(aside), times * math.sqrt(turn)


MEASURED: Final = MotionModel(0.0, 0.0, 0.02, 0.04, 0.03)
"""The uncertainty of odometry that wheels measure: the defaults of the localizer's parameters."""

COMMANDED: Final = MotionModel(0.025, 0.04)
"""The uncertainty of odometry that consists of commands: the defaults of the localizer as well."""


@dataclass(frozen=True)
class OdometryStep:
    """Motion over a period, along the middle heading: meters forward and to the left, radians to
    the left, seconds in motion; `measured` by the wheels, or only commanded. Its deviations are
    `uncertain` times those of the motion model; and as the gain of odometry is not known exactly,
    the distance is off by `gain_m` [m].
    """

    ahead: float
    aside: float
    turned: float
    moving_s: float
    measured: bool = True
    uncertain: float = 1.0
    gain_m: float = 0.0


def move_pose(pose: Pose, step: OdometryStep) -> Pose:
    """Return the expected pose after `step`: a chord in the direction of the middle heading."""
    x, y, theta = pose
    chord = theta + 0.5 * step.turned
    cosine, sine = math.cos(chord), math.sin(chord)
    return (
        x + step.ahead * cosine - step.aside * sine,
        y + step.ahead * sine + step.aside * cosine,
        theta + step.turned,
    )


def odometry_step(relative: Pose) -> OdometryStep:
    """Return the step that leads to `relative`, a pose seen from where the step started."""
    back = -0.5 * relative[2]
    ahead, aside, _ = compose((0.0, 0.0, back), relative)
    moved = relative != (0.0, 0.0, 0.0)
    return OdometryStep(ahead, aside, relative[2], 1.0 if moved else 0.0)
