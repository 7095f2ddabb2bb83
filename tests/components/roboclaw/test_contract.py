"""The base on an emulated RoboClaw keeps the contract of a base, and what is particular to it."""

import math
import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import pytest

from cairn.testing.base_contract import BaseContract
from cairn.testing.reading import Arrival, Reading
from cairn.testing.robot import Robot
from planar.messages import planar_pose
from planar.poses import Pose, wrap
from schemas.diagnostic_msgs import DiagnosticArray
from schemas.geometry_msgs import Twist, Vector3
from schemas.nav_msgs import Odometry
from schemas.sensor_msgs import BatteryState
from tests.components.roboclaw.emulated_base import DEPLOYMENT, EmulatedBase, emulated_base

pytestmark = pytest.mark.realtime

AHEAD = Twist(linear=Vector3(x=0.5))
LEFT = Twist(angular=Vector3(z=2.0))
DEVICE_TIMEOUT_S = 1.0  # as in the deployment
COASTING_S = 0.5  # of motors without power


class TestRoboclawBase(BaseContract):
    deployment = DEPLOYMENT
    rate_hz = 40.0
    top_speed = 0.8
    turn = 1.0
    stop_limit_s = 2.5  # the controller's own time limit is 1 s
    cycles = 6

    @pytest.fixture(scope="class")
    @classmethod
    def device(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedBase]:
        with emulated_base(tmp_path_factory.mktemp("line")) as base:
            yield base

    def test_a_square_by_odometry_is_the_square_of_the_wheels(
        self, robot: Robot, output: Reading[Odometry], device: EmulatedBase
    ) -> None:
        origin = device.true_pose()
        output.await_count(2)
        told = output.messages[-1]
        for _ in range(4):
            with robot.sending("cmd_vel", AHEAD):
                _await_way(output, 0.2)
            with robot.sending("cmd_vel", LEFT):
                _await_turn(output, math.pi / 2)
        assert device.await_stand(2.0)
        true = relative(origin, device.true_pose())
        output.await_that(
            lambda arrivals: any(_near(relative(_pose(told), _pose(one)), true) for one in arrivals),
            f"the pose to which the wheels have led, {true}",
            after=output.count,
        )
