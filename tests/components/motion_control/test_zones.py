"""Motion control and zones of the map: not to enter keepout zones, to drive slowly in slow ones."""

import math
from typing import Any

import numpy as np
import pytest

from cairn import from_ns
from cairn.components.motion_control.config import MotionControlConfig
from cairn.components.motion_control.zone_limits import ZoneLimits
from cairn.planar.polygons import distance_to_edges, is_inside
from cairn.planar.zones import zone_edges, zone_of
from cairn.schemas.cairn_nav_msgs import MotionStatus, NavCommand, Plan, ReasonCode, Zone, Zones
from cairn.schemas.std_msgs import Header
from tests import zone_features
from tests.components.motion_control.simulated_drive import SimulatedDrive
from tests.components.motion_control.world import Robot, World, box
from tests.zone_features import Box

pytestmark = pytest.mark.slow

RADIUS = 0.22


def area(kind: str, box: Box, name: str = "area", **properties: float) -> Zone:
    return zone_of(zone_features.area(kind, box, name, **properties))


def at_rest(**parameters: Any) -> SimulatedDrive:
    """A robot that stands at (-3, 0) in a hall."""
    return SimulatedDrive(World([*box(0, 0, 20, 20)]), Robot((-3.0, 0.0, 0.0)), **parameters)


def driving(*zones: Zone) -> SimulatedDrive:
    """A robot that drives at full speed on a path along y = 0 to x = 3, and gets these zones."""
    drive = at_rest()
    drive.command(7, NavCommand.FOLLOW, (3.0, 0.0, 0.0))
    drive.publish_plan(7, (-3, 0), (3, 0))
    drive.run_for(2.0)
    assert drive.robot.speed == pytest.approx(0.6, abs=0.01)
    publish(drive, *zones)
    return drive


def publish(drive: SimulatedDrive, *zones: Zone) -> None:
    header = Header(stamp=from_ns(drive.now), frame_id="map")
    drive.motion_control.publish("zones", Zones(header=header, version=1, zones=zones))


def depth(drive: SimulatedDrive, zone: Zone) -> float:
    """Return how far [m] the robot reaches over the edge of a zone; negative outside."""
    x, y, _ = drive.robot.pose
    apart = distance_to_edges(zone_edges(zone), x, y)
    return RADIUS + apart if is_inside(zone_edges(zone), x, y) else RADIUS - apart


def deepest(drive: SimulatedDrive, zone: Zone, seconds: float) -> float:
    found = -math.inf
    for _ in range(round(seconds / 0.02)):
        drive.run_for(0.02)
        found = max(found, depth(drive, zone))
    return found


def test_robot_stops_before_a_keepout_zone_that_appears_across_its_path() -> None:
    zone = area("keepout", (0.0, -8.0, 1.0, 8.0), "wet floor")
    drive = driving(zone)

    assert deepest(drive, zone, 15.0) < 0.0

    assert drive.status.state == MotionStatus.BLOCKED
    assert drive.status.reason_code == ReasonCode.KEEPOUT_ZONE
    assert "keepout zone wet floor is in the way" in drive.status.reason
    assert drive.robot.pose[0] > -1.0  # it drove up to it


def test_robot_drives_around_a_small_keepout_zone_on_its_path() -> None:
    zone = area("keepout", (0.4, -0.2, 0.8, 0.2))
    drive = driving(zone)

    assert deepest(drive, zone, 20.0) < 0.0

    assert drive.status.state == MotionStatus.DONE


def test_recovery_behaviors_do_not_enter_a_keepout_zone() -> None:
    behind, around = area("keepout", (-3.9, -1.0, -3.3, 1.0)), area("keepout", (-2.5, -4, 4, 4))
    for behavior in (NavCommand.BACK_OFF, NavCommand.EXPLORE):
        drive = at_rest()
        publish(drive, Zone(**{**vars(behind), "name": "behind"}), around)
        drive.command(1, behavior, distance=2.0)
        found = max(deepest(drive, behind, 5.0), deepest(drive, around, 5.0))
        assert found < 0.0, behavior


def test_robot_in_a_keepout_zone_stops_until_a_plan_leads_out() -> None:
    zone = area("keepout", (-8.0, -0.6, 8.0, 1.0), "wet floor")
    drive = driving(zone)

    drive.run_for(1.0)
    assert drive.robot.speed == 0.0
    assert drive.status.state == MotionStatus.BLOCKED
    assert drive.status.reason_code == ReasonCode.IN_KEEPOUT

    stamp = Header(stamp=from_ns(drive.now))
    x = drive.robot.pose[0]
    drive.command(7, NavCommand.FOLLOW, (3.0, -1.0, 0.0))
    drive.publish_plan(7, (x, 0), (x, -1), (3, -1), header=stamp)
    drive.run_for(25.0, until=MotionStatus.DONE)
    assert drive.status.state == MotionStatus.DONE
    assert depth(drive, zone) < 0.0


@pytest.mark.parametrize("behavior", [NavCommand.BACK_OFF, NavCommand.EXPLORE])
def test_robot_in_a_keepout_zone_moves_by_a_plan_only(behavior: int) -> None:
    drive = at_rest()
    publish(drive, area("keepout", (-8.0, -8.0, 8.0, 8.0), "all"))
    drive.command(1, behavior, distance=2.0)
    drive.run_for(3.0)
    assert drive.robot.pose == pytest.approx((-3.0, 0.0, 0.0), abs=1e-3)
    assert drive.status.state == MotionStatus.BLOCKED
    assert "in keepout zone all: only a plan leads out of it" in drive.status.reason


def test_robot_that_must_stay_in_a_keepout_zone_reports_it() -> None:
    drive = driving()
    drive.publish_plan(7, outcome=Plan.START_IN_KEEPOUT, reason="the robot is in zone x")
    drive.run_for(1.0)
    assert drive.robot.speed == 0.0
    assert drive.status.state == MotionStatus.STOPPED
    assert drive.status.reason_code == ReasonCode.IN_KEEPOUT
    assert "the robot is in zone x" in drive.status.reason


def test_robot_that_stands_in_a_keepout_zone_reports_it() -> None:
    drive = at_rest()
    publish(drive, area("keepout", (-8.0, -8.0, 8.0, 8.0), "all"))
    drive.command(1, NavCommand.STAND)
    drive.run_for(0.5)
    assert drive.status.state == MotionStatus.STANDING
    assert drive.status.reason == "in keepout zone all"


def test_robot_drives_no_faster_than_a_slow_zone_allows_and_brakes_before_it() -> None:
    drive = driving(area("slow", (-0.5, -1.0, 1.0, 1.0), speed=0.2))
    inside: list[float] = []
    before: list[float] = []
    while drive.status.state == MotionStatus.MOVING:
        drive.run_for(0.02)
        x = drive.robot.pose[0]
        (inside if -0.5 < x < 1.0 else before).append(drive.robot.speed)
    assert max(inside) <= 0.22
    assert np.mean(inside) > 0.18
    assert max(before) == pytest.approx(0.6, abs=0.01)
    assert drive.status.state == MotionStatus.DONE


def test_robot_slows_down_within_a_second_in_a_new_slow_zone() -> None:
    drive = driving(area("slow", (-8.0, -8.0, 8.0, 8.0), speed=0.2))
    drive.run_for(0.9)
    assert drive.robot.speed <= 0.21


def test_changed_parameters_keep_the_zones() -> None:
    zone = area("keepout", (0.0, -8.0, 1.0, 8.0))
    drive = driving(zone)
    drive.motion_control.set_parameters({"margin": 0.06})
    assert deepest(drive, zone, 8.0) < 0.0


def test_left_keepout_zone_counts_again_when_the_whole_robot_is_outside() -> None:
    zone = area("keepout", (0.0, 0.0, 2.0, 2.0), "a")
    limits = ZoneLimits(MotionControlConfig().limits(), [zone])
    outside = (-0.3, 1.0, 0.0)
    assert limits.enter((-0.1, 1.0, 0.0)) == ""
    assert len(limits.edges_near((-0.1, 1.0, 0.0), 1.0))
    assert limits.enter((0.1, 1.0, 0.0)) == "a"
    assert limits.enter((-0.1, 1.0, 0.0)) == "a"
    assert not len(limits.edges_near((-0.1, 1.0, 0.0), 1.0))
    assert limits.enter(outside) == ""
    assert len(limits.edges_near(outside, 1.0))
