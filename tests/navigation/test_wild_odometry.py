"""Odometry that is late, out of order and incomplete: the robot drives on, and never collides."""

from collections.abc import Callable

import pytest

from cairn.schemas.cairn_nav_msgs import NavigationStatus
from tests.navigation.driving import LockstepRobot

RobotFactory = Callable[..., LockstepRobot]

BASE = "components.base.parameters"
WILD = (f"{BASE}.odometry_delay_s=0.3", f"{BASE}.odometry_loss=0.02")


@pytest.mark.accuracy
def test_robot_arrives_with_odometry_that_is_late_out_of_order_and_incomplete(
    drive: RobotFactory, caplog: pytest.LogCaptureFixture
) -> None:
    robot = drive(*WILD)

    for goal in ((7.5, 5.0), (1.2, 3.0), (6.4, 1.8)):
        robot.go(*goal)
        robot.assert_arrives(goal)

    assert NavigationStatus.RECOVERING not in robot.states()
    for wrong in ("jumped", "back in time", "runs backwards", "set back", "ignored"):
        assert wrong not in caplog.text
