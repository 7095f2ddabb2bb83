"""Drives of a simulated robot that recognizes objects, for tests of landmarks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cairn.components.slam.mapping import Mapper
from cairn.planar.poses import Pose, compose
from cairn.visual_map.observations import Observation

SECOND = 1_000_000_000
STEP_NS = 100_000_000
RANGE_SD, BEARING_SD = 0.05, 0.01

OBJECTS = {
    1: (3.0, 0.5),
    2: (5.5, 3.0),
    3: (3.0, 5.5),
    4: (-0.5, 3.0),
    5: (2.5, 3.0),
    6: (5.0, 0.0),
    7: (0.0, 5.5),
    2_000_000_000: (4.5, 5.5),
}
"""Positions [m] of objects in a hall, around and in the circle that the robot drives."""


@dataclass(frozen=True)
class Base:
    """How odometry relates to the motion of the robot.

    The robot performs the shares `forward_gain` and `turn_gain` of the motion that odometry states,
    `lag_steps` steps of 0.1 s later, and drifts by `drift` [rad] per step.
    """

    forward_gain: float = 1.0
    turn_gain: float = 1.0
    lag_steps: int = 0
    drift: float = 0.0


Camera = Callable[[int, Pose, list[Observation]], Sequence[Observation]]
"""Returns what the camera reports at a step, from the true pose and what is in view."""


@dataclass
class Drive:
    """A drive on circles: true and odometric pose at each step of 0.1 s."""

    seconds: float
    base: Base = Base()
    objects: Mapping[int, tuple[float, float]] = field(default_factory=lambda: OBJECTS)
    camera: Camera = lambda _step, _pose, seen: seen
    truth: list[Pose] = field(default_factory=list)

    def into(self, mapper: Mapper) -> Mapper:
        """Add the drive to a mapper, which is returned."""
        random = np.random.default_rng(1)
        for step, (odometry, pose) in enumerate(self._poses()):
            stamp = step * STEP_NS
            self.truth.append(pose)
            mapper.add_odometry(stamp, odometry)
            if step % 3 == 0:
                seen = self.camera(step, pose, look(pose, self.objects, random))
                mapper.add_observations(stamp, odometry, seen)
        return mapper

    def _poses(self) -> Iterator[tuple[Pose, Pose]]:
        odometry: Pose = (0.0, 0.0, 0.0)
        pose: Pose = (2.5, 0.9, 0.0)
        commands: list[tuple[float, float]] = []
        for step in range(round(self.seconds * 10)):
            yield odometry, pose
            # It stops now and then, so that a lag shows.
            driving = step % 70 < 60
            commands.append((0.05, 0.025 + 0.02 * math.sin(step / 9.0)) if driving else (0.0, 0.0))
            ahead, turn = commands[-1]
            odometry = compose(odometry, _step(ahead, turn))
            late = step - self.base.lag_steps
            if late >= 0:
                ahead, turn = commands[late]
                moved = self.base.drift if ahead else 0.0
                turn = turn * self.base.turn_gain + moved
                pose = compose(pose, _step(ahead * self.base.forward_gain, turn))


def look(
    pose: Pose, objects: Mapping[int, tuple[float, float]], random: np.random.Generator
) -> list[Observation]:
    """Return the observations of the objects in view from a pose, with noise."""
    seen = []
    for object_id, (x, y) in objects.items():
        way = math.hypot(x - pose[0], y - pose[1])
        bearing = math.remainder(math.atan2(y - pose[1], x - pose[0]) - pose[2], math.tau)
        range_error, bearing_error = random.normal(0, (RANGE_SD, BEARING_SD))
        if abs(bearing) < 0.7 and 0.5 < way < 6.0:
            seen.append(
                Observation(
                    object_id,
                    way + range_error,
                    bearing + bearing_error,
                    RANGE_SD**2,
                    BEARING_SD**2,
                )
            )
    return seen


def map_errors(
    found: Mapping[int, tuple[float, float]], true: Mapping[int, tuple[float, float]]
) -> dict[int, float]:
    """Return how far each landmark is from its true position [m] after a rigid alignment."""
    ids = sorted(found)
    a, b = np.array([found[k] for k in ids]), np.array([true[k] for k in ids])
    p, q = a - a.mean(axis=0), b - b.mean(axis=0)
    product = p.T @ q
    turn = math.atan2(product[0, 1] - product[1, 0], product[0, 0] + product[1, 1])
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    errors = np.hypot(*(p @ rotation - q).T)
    return dict(zip(ids, errors.tolist(), strict=True))


def _step(ahead: float, turn: float) -> Pose:
    return (ahead * math.cos(0.5 * turn), ahead * math.sin(0.5 * turn), turn)
