"""People who walk and stop before a robot in their way."""

import math
from collections.abc import Sequence

from tests.components.motion_control.world import Disc, Robot


class Walker:
    """A person who starts at `begin` [s] with a velocity [m/s] and waits for a near robot."""

    def __init__(
        self,
        robot: Robot,
        start: tuple[float, float],
        velocity: tuple[float, float],
        begin: float,
        polite: float = 0.75,
    ) -> None:
        self._robot, self._velocity, self._begin, self._polite = robot, velocity, begin, polite
        self._x, self._y = start
        self._time = 0.0

    def __call__(self, time: float) -> Sequence[Disc]:
        """The person as a disc at that time [s]; times must increase."""
        seconds, self._time = time - self._time, time
        vx, vy = self._velocity
        dx, dy = self._robot.pose[0] - self._x, self._robot.pose[1] - self._y
        waits = math.hypot(dx, dy) < self._polite and dx * vx + dy * vy > 0
        if time > self._begin and not waits:
            self._x += vx * seconds
            self._y += vy * seconds
        return [(self._x, self._y, 0.25)]
