"""Paths and the robot's progress on them; detours; velocity limits; the safety stop."""

from itertools import pairwise

import numpy as np
import pytest

from cairn.components.motion_control.config import Timeouts
from cairn.components.motion_control.detour import DetourSearch
from cairn.components.motion_control.followed_path import SPACING_M, FollowedPath
from cairn.components.motion_control.safety_stop import SafetyStop
from cairn.components.motion_control.scan_memory import NearbyObstacles
from cairn.components.motion_control.velocity_limits import (
    CommandLimiter,
    MotionLimits,
    VelocityTarget,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from tests.components.motion_control.world import LIMITS, route
from tests.wording import assert_words

SECOND = 1_000_000_000


def test_path_ahead_starts_beside_the_robot_and_ends_at_the_goal() -> None:
    path = route((0, 0), (1, 0), (1, 1))

    way = path.ahead((0.5, 0.1, 0.0)).copy()

    assert way[0] == pytest.approx([0.0, -0.1])
    assert way[-1] == pytest.approx([0.5, 0.9])
    assert np.hypot(*np.diff(way[:9], axis=0).T) == pytest.approx(SPACING_M)
    assert path.left == pytest.approx(1.5)
    assert path.off == pytest.approx(0.1)


def test_robot_stays_on_its_branch_where_the_path_crosses_itself() -> None:
    path = route((0, 0), (4, 0), (4, 2), (2, 2), (2, -2))
    for x in np.arange(0.0, 2.01, 0.1):
        path.ahead((float(x), 0.02, 0.0))

    assert path.left == pytest.approx(2 + 2 + 2 + 4)


def test_kidnapped_robot_is_found_on_the_path() -> None:
    path = route((0, 0), (10, 0))
    path.ahead((0, 0, 0))

    path.ahead((7, 0, 0))

    assert path.left == pytest.approx(3)


def test_path_without_poses_leads_to_its_goal() -> None:
    path = FollowedPath(np.empty((0, 3)), (1.0, 2.0, 0.0))

    assert path.ahead((0, 0, 0)).tolist() == [[1.0, 2.0]]
    assert path.left == 0.0


def test_repeated_poses_are_harmless() -> None:
    path = route((0, 0), (0, 0), (1, 0), (1, 0), (1, 0))

    way = path.ahead((0, 0, 0))

    assert np.isfinite(way).all()
    assert way[-1] == pytest.approx([1.0, 0.0])


def wall(y0: float, y1: float, x: float = 1.0) -> np.ndarray:
    ys = np.arange(y0, y1, 0.02)
    return np.column_stack((np.full(ys.size, x), ys))


def test_detour_leads_around_an_obstacle() -> None:
    points = wall(-0.3, 0.5)

    way = DetourSearch(LIMITS).find(points, 2.0, 0.0)

    assert way is not None
    assert way[0].tolist() == [0.0, 0.0]
    assert way[-1].tolist() == [2.0, 0.0]
    assert way[:, 1].min() < -0.5
    fine = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(way)])
    apart = np.hypot(*(fine[:, None] - points[None]).transpose(2, 0, 1))
    assert apart.min() > LIMITS.radius + 0.03


def test_there_is_no_detour_through_a_closed_wall() -> None:
    assert DetourSearch(LIMITS).find(wall(-4, 4), 2.0, 0.0) is None


def test_there_is_no_detour_to_an_occupied_position() -> None:
    assert DetourSearch(LIMITS).find(wall(-0.3, 0.3), 1.1, 0.0) is None


def test_detour_leads_out_of_the_margin() -> None:
    points = wall(-3, 3, x=-0.23)

    way = DetourSearch(LIMITS).find(points, 0.0, 1.5)
    beside = DetourSearch(LIMITS).find(points, 0.5, 1.0)

    assert way is None  # that is within the margin too
    assert beside is not None


def test_speeds_allow_stopping_in_time() -> None:
    for distance in np.arange(0.0, 1.0, 0.01).tolist():
        speed = LIMITS.speed_to_stop_in(distance)

        stopping = speed * LIMITS.latency + speed**2 / (2 * LIMITS.braking)
        assert stopping <= distance + 1e-9
        assert speed <= LIMITS.speed
    assert LIMITS.speed_to_stop_in(1.0) == LIMITS.speed


def test_speed_is_lower_with_less_clearance_and_in_curves() -> None:
    room = [LIMITS.speed_beside(clear) for clear in (0.0, 0.05, 0.1, 0.2, 1.0)]
    bends = [LIMITS.speed_in(bend) for bend in (0.0, 1.0, 2.0, 4.0)]

    assert room == sorted(room)
    assert room[0] == LIMITS.creep_speed
    assert room[-1] == LIMITS.speed
    assert bends == sorted(bends, reverse=True)
    assert bends[-1] * 4.0 < LIMITS.turn_speed


@pytest.mark.parametrize("direction", [1.0, -1.0], ids=["forward", "backward"])
def test_only_obstacles_in_the_direction_of_motion_stop_the_robot(direction: float) -> None:
    target = VelocityTarget(speed=0.15 * direction)

    def commanded(x: float) -> float:
        obstacles = NearbyObstacles(wall(-0.3, 0.3, x), abs(x))
        return CommandLimiter(LIMITS).command(target, SECOND, (0.0, 0.0), obstacles)[0]

    near = LIMITS.radius + 0.01
    assert commanded(near * direction) == pytest.approx(0.0)
    assert commanded(-near * direction) * direction > 0.05


def test_robot_drives_more_slowly_toward_an_obstacle_when_odometry_is_late() -> None:
    measured, target = (0.5, 0.0), VelocityTarget(speed=0.6)
    obstacles = NearbyObstacles(wall(-0.3, 0.3, 0.7), 0.7)

    def commanded(late_s: float) -> float:
        limiter = CommandLimiter(LIMITS)
        limiter._command = measured
        return limiter.command(target, SECOND, measured, obstacles, late_s)[0]

    assert 0.05 < commanded(0.2) < commanded(0.1) < commanded(0.0)
    # By the time that it starts to brake later.
    free = 0.7 - LIMITS.minimum_radius - 0.01
    assert commanded(0.2) == pytest.approx(LIMITS.speed_to_stop_in(free, 0.2), abs=0.02)


def test_contact_minimum_and_keepout_radius_increase_in_this_order() -> None:
    for margin in (0.01, 0.05, 0.5):
        limits = MotionLimits(**{**vars(LIMITS), "margin": margin})

        assert limits.radius < limits.contact_radius < limits.minimum_radius < limits.keepout_radius


TIMEOUTS = Timeouts(odom=10.0)
TOPICS = {name: f"/r/{name}" for name in ("nav_command", "localization", "odom", "scan")}


def stop_with_odometry() -> SafetyStop:
    safety_stop = SafetyStop(TOPICS)
    safety_stop.note("odom", 10 * SECOND, 10 * SECOND)
    return safety_stop


def reason(safety_stop: SafetyStop, now: int) -> str:
    return safety_stop.reason(now, TIMEOUTS, needs_pose=False, pose_known=True)[1]


def test_stale_input_is_named_with_its_age() -> None:
    safety_stop = stop_with_odometry()

    assert_words(reason(safety_stop, 10 * SECOND), "no scan yet", "/r/scan")
    safety_stop.note("scan", 10 * SECOND, 10 * SECOND)
    assert reason(safety_stop, 10 * SECOND + SECOND // 2) == ""
    assert_words(reason(safety_stop, 10 * SECOND + 620_000_000), "no scan", "0.62 s", "/r/scan")


def test_age_of_an_input_counts_from_its_stamp_not_from_its_arrival() -> None:
    safety_stop = stop_with_odometry()
    safety_stop.note("scan", 9 * SECOND, 10 * SECOND)

    assert_words(reason(safety_stop, 10 * SECOND), "no scan", "1.00 s", "/r/scan")


def test_message_from_the_future_is_not_fresh_for_longer() -> None:
    safety_stop = stop_with_odometry()
    safety_stop.note("scan", 99 * SECOND, 10 * SECOND)

    assert_words(reason(safety_stop, 11 * SECOND), "no scan", "1.00 s", "/r/scan")


def test_fresh_input_is_stale_after_a_time_reset_until_it_arrives_again() -> None:
    safety_stop = stop_with_odometry()
    safety_stop.note("scan", 100 * SECOND, 100 * SECOND)

    safety_stop.note("odom", 40 * SECOND, 40 * SECOND)
    stale = reason(safety_stop, 40 * SECOND)
    safety_stop.note("scan", 40 * SECOND, 40 * SECOND)

    assert_words(stale, "no scan", "time", "/r/scan")
    assert reason(safety_stop, 40 * SECOND) == ""
    assert_words(reason(safety_stop, 41 * SECOND), "no scan", "1.00 s", "/r/scan")


def test_scans_without_measurements_are_named_as_such() -> None:
    safety_stop = stop_with_odometry()
    safety_stop.note("scan", 10 * SECOND, 10 * SECOND)
    safety_stop.scan_informative = False

    assert_words(reason(safety_stop, 11 * SECOND), "no valid scan", "1.00 s", "/r/scan")


def test_lost_robot_stops_until_its_health_exceeds_the_limit_clearly() -> None:
    safety_stop = stop_with_odometry()
    for name in ("scan", "localization"):
        safety_stop.note(name, 10 * SECOND, 10 * SECOND)

    def lost(health: float, located: bool = True) -> bool:
        estimate = LocalizationEstimate(health=health, located=located, reason="it slips")
        safety_stop.note_localization(estimate, 0.3)
        found = safety_stop.reason(10 * SECOND, TIMEOUTS, needs_pose=True, pose_known=True)[1]
        assert found in ("", f"the robot is lost, health {health:.2f}: it slips")
        return bool(found)

    assert [lost(health) for health in (0.31, 0.29, 0.34, 0.36, 0.31)] == [
        False, True, True, False, False,
    ]  # fmt: skip
    assert lost(0.9, located=False)
    assert reason(safety_stop, 10 * SECOND) == ""  # recovery motions need no pose


def test_unknown_pose_stops_only_a_behavior_that_needs_it() -> None:
    safety_stop = stop_with_odometry()
    for name in ("scan", "localization"):
        safety_stop.note(name, 10 * SECOND, 10 * SECOND)

    _, unknown = safety_stop.reason(10 * SECOND, TIMEOUTS, needs_pose=True, pose_known=False)

    assert_words(unknown, "no pose", "/r/localization", "odometry")
    assert reason(safety_stop, 10 * SECOND) == ""
