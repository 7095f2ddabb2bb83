"""Scans whose form changes from turn to turn, as common scanners send them: the robot drives."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cairn import SENSOR
from cairn.schemas.message import received_message
from cairn.schemas.sensor_msgs import LaserScan
from tests.navigation.driving import LockstepRobot

RobotFactory = Callable[..., LockstepRobot]


def whole_turn(scan: LaserScan, first: float, beams: int) -> LaserScan:
    """Return a scan of `beams` from the angle `first` on [rad], with the measured ranges in it."""
    step = scan.angle_increment
    angles = scan.angle_min + step * np.arange(scan.ranges.size)
    turn = np.full(beams, np.nan, np.float32)
    places = np.rint((angles - first) % math.tau / step).astype(int)
    turn[places[places < beams]] = scan.ranges[places < beams]
    return replace(
        scan, angle_min=first, angle_max=first + (beams - 1) * step, time_increment=0.0, ranges=turn
    )


def turned_round(scan: LaserScan) -> LaserScan:
    """Return a scan whose beams are in the opposite order."""
    return replace(
        scan,
        angle_min=scan.angle_max,
        angle_max=scan.angle_min,
        angle_increment=-scan.angle_increment,
        time_increment=0.0,
        ranges=scan.ranges[::-1],
    )


def with_first_repeated(scan: LaserScan) -> LaserScan:
    """Return a scan of a whole turn whose last beam is its first one."""
    beams = math.ceil(math.tau / scan.angle_increment)
    turn = whole_turn(scan, -math.pi, beams)
    end, ranges = turn.angle_max + turn.angle_increment, np.append(turn.ranges, turn.ranges[0])
    return replace(turn, angle_max=end, ranges=ranges)


def wrong_end(scan: LaserScan) -> LaserScan:
    """Return a scan as it is received of a driver that always sends the same `angle_max`."""
    values = {**vars(scan), "angle_max": scan.angle_max + 5.0 * scan.angle_increment}
    return received_message(LaserScan, values)


FORMS: tuple[Callable[[LaserScan], LaserScan], ...] = (
    lambda scan: whole_turn(scan, -math.pi, 340),
    lambda scan: whole_turn(scan, -math.pi, 341),
    lambda scan: whole_turn(scan, 0.0, 342),
    turned_round,
    with_first_repeated,
    wrong_end,
)


def test_robot_arrives_with_scans_whose_form_changes_from_turn_to_turn(drive: RobotFactory) -> None:
    robot = drive(
        "components.range_scanner.topics={scan: measured}", "external_topics=[/robot/scan]"
    )
    sent: list[LaserScan] = []

    def on_scan() -> None:
        form = FORMS[len(sent) % len(FORMS)]
        sent.append(form(measured.messages[-1]))
        robot.publish("scan", sent[-1], qos=SENSOR, handled=False)

    measured = robot.read("measured", LaserScan, on_message=on_scan)

    for goal in ((4.0, 1.2), (6.4, 1.8)):
        robot.go(*goal)
        robot.assert_arrives(goal)

    assert len({(scan.ranges.size, scan.angle_increment > 0.0) for scan in sent}) >= 5
