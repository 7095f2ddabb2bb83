"""The pipeline of a command: points that cannot matter are left out, and change nothing."""

import math

import numpy as np
import pytest

from cairn.components.velocity_gate.collision_monitor import Array
from cairn.components.velocity_gate.config import VelocityGateConfig
from cairn.components.velocity_gate.limiter import Velocity
from cairn.components.velocity_gate.pipeline import CommandPipeline, Surroundings
from cairn.components.velocity_gate.recent_sweeps import RecentSweeps
from cairn.planar.poses import Pose
from tests.sweeps import sampled

SQUARE = ((0.3, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.3, -0.2))


class KnownPoints(RecentSweeps):
    """Points in the robot's frame; all of them, or as many as are asked for."""

    def __init__(self, points: Array, *, all_of_them: bool) -> None:
        super().__init__(10**9, 0.2, 5.0)
        self._given, self._all = points, all_of_them

    def points(self, robot: Pose, within: float) -> Array:
        """Return the points up to `within` [m], or all."""
        del robot
        apart = np.hypot(self._given[:, 0], self._given[:, 1])
        return self._given[apart < (math.inf if self._all else within)]

    def share_seen(self, robot: Pose, places: Array) -> float:
        """All ground was seen."""
        del robot, places
        return 1.0


@pytest.mark.parametrize(
    ("footprint", "slowdown_time"), sampled([((), 1.5), (SQUARE, 0.3)]), ids=["round", "square"]
)
def test_distant_points_make_no_difference(
    footprint: tuple[tuple[float, float], ...], slowdown_time: float
) -> None:
    random = np.random.default_rng(1)
    # Low jerk and slow turning: long ramps and long stops.
    config = VelocityGateConfig(
        footprint=footprint, jerk=8.0, turn_jerk=20.0, braking=0.4, turn_braking=0.5,
        slowdown_time=slowdown_time, slowdown_speed=0.45,
    )  # fmt: skip
    near, everything = CommandPipeline(config), CommandPipeline(config)
    reduced = 0
    for _ in range(60):
        points = random.uniform(-1.0, 1.0, (6, 2))
        points = points[np.hypot(points[:, 0], points[:, 1]) > 0.4]
        desired = float(random.uniform(-0.4, 0.8)), float(random.uniform(-2.0, 2.0))
        for _ in range(20):
            measured: Velocity = (near.command[0] + float(random.normal(0.0, 0.3)), 0.0)
            outputs = [
                pipeline.step(
                    desired,
                    0.05,
                    Surroundings(
                        KnownPoints(points, all_of_them=pipeline is everything),
                        (0.0, 0.0, 0.0),
                        0.05,
                        measured,
                    ),
                )
                for pipeline in (near, everything)
            ]
            assert outputs[0] == outputs[1]
            reduced += "approach" in outputs[0].limits
    assert reduced > 20
