"""A hall with landmarks and a robot that drives on a figure eight, for tests of the localizer."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cairn.components.localizer.observations import Landmark
from cairn.planar.poses import Pose
from cairn.visual_map.observations import Observation

PLACES = {
    1: (3.0, 0.0),
    2: (2.0, 3.0),
    3: (-1.0, 3.5),
    4: (-3.5, 1.0),
    5: (-3.0, -2.5),
    6: (0.5, -3.5),
    7: (3.2, -2.0),
}
RANGE_SD, BEARING_SD = 0.08, 0.015
STEP_S = 0.2


@dataclass(frozen=True)
class Moment:
    """Time [s], command [m/s, rad/s], the true pose and what is seen from it."""

    time: float
    forward: float
    turn: float
    pose: Pose
    observations: list[Observation]


def drive(seconds: float, seed: int = 0, blind: tuple[float, float] = (0, 0)) -> Iterator[Moment]:
    """Yield the moments of a drive; the base follows commands exactly, except for noise."""
    random = np.random.default_rng(seed)
    x, y, theta = 0.0, 0.0, 0.0
    for k in range(int(seconds / STEP_S)):
        t = k * STEP_S
        turn = 0.2 if t % 62.8 < 31.4 else -0.2
        seen = []
        if not blind[0] <= t < blind[1]:
            for object_id, (mx, my) in PLACES.items():
                bearing = (math.atan2(my - y, mx - x) - theta + math.pi) % (2 * math.pi) - math.pi
                if abs(bearing) < 0.6:
                    seen.append(
                        Observation(
                            object_id,
                            math.hypot(mx - x, my - y) + random.normal(0, RANGE_SD),
                            bearing + random.normal(0, BEARING_SD),
                            RANGE_SD**2,
                            BEARING_SD**2,
                        )
                    )
        yield Moment(t, 0.25, turn, (x, y, theta), seen)
        middle = theta + 0.5 * turn * STEP_S
        x += 0.25 * STEP_S * math.cos(middle)
        y += 0.25 * STEP_S * math.sin(middle)
        theta += turn * STEP_S + random.normal(0, 0.004)


def landmarks(**moved: tuple[float, float]) -> list[Landmark]:
    """The map; `o3=(1.0, 0.5)` moves object 3 by that distance [m] from its true position."""
    shift = {int(name[1:]): move for name, move in moved.items()}
    return [
        Landmark(i, x + shift.get(i, (0, 0))[0], y + shift.get(i, (0, 0))[1], reliability=0.9)
        for i, (x, y) in PLACES.items()
    ]
