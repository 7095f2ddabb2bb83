"""Paths and where on them the robot is; detours; where the robot is by odometry."""

import math
from itertools import pairwise

import numpy as np
import pytest

from cairn.components.motion_control.detour import DetourSearch
from cairn.components.motion_control.freshness import Freshness
from cairn.components.motion_control.limits import Limits
from cairn.components.motion_control.route import SPACING, Route
from cairn.components.motion_control.whereabouts import Whereabouts
from tests.components.motion_control.world import LIMITS, route

SECOND = 1_000_000_000


def test_the_way_ahead_begins_beside_the_robot_and_ends_at_the_goal() -> None:
    path = route((0, 0), (1, 0), (1, 1))

    way = path.ahead((0.5, 0.1, 0.0)).copy()

    assert way[0] == pytest.approx([0.0, -0.1])
    assert way[-1] == pytest.approx([0.5, 0.9])
    assert np.hypot(*np.diff(way[:9], axis=0).T) == pytest.approx(SPACING)
    assert path.left == pytest.approx(1.5)
    assert path.off == pytest.approx(0.1)


def test_where_a_path_crosses_itself_the_robot_stays_on_its_branch() -> None:
    path = route((0, 0), (4, 0), (4, 2), (2, 2), (2, -2))
    for x in np.arange(0.0, 2.01, 0.1):
        path.ahead((float(x), 0.02, 0.0))

    assert path.left == pytest.approx(2 + 2 + 2 + 4)


def test_a_robot_that_was_carried_away_is_found_on_the_path() -> None:
    path = route((0, 0), (10, 0))
    path.ahead((0, 0, 0))

    path.ahead((7, 0, 0))

    assert path.left == pytest.approx(3)


def test_a_path_without_poses_leads_to_its_goal() -> None:
    path = Route(np.empty((0, 3)), (1.0, 2.0, 0.0))

    assert path.ahead((0, 0, 0)).tolist() == [[1.0, 2.0]]
    assert path.left == 0.0


def test_poses_that_repeat_do_no_harm() -> None:
    path = route((0, 0), (0, 0), (1, 0), (1, 0), (1, 0))

    way = path.ahead((0, 0, 0))

    assert np.isfinite(way).all()
    assert way[-1] == pytest.approx([1.0, 0.0])


def wall(y0: float, y1: float, x: float = 1.0) -> np.ndarray:
    ys = np.arange(y0, y1, 0.02)
    return np.column_stack((np.full(ys.size, x), ys))


def test_a_detour_leads_around_what_stands_in_the_way() -> None:
    points = wall(-0.3, 0.5)

    way = DetourSearch(LIMITS).find(points, 2.0, 0.0)

    assert way is not None
    assert way[0].tolist() == [0.0, 0.0]
    assert way[-1].tolist() == [2.0, 0.0]
    assert way[:, 1].min() < -0.5
    fine = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(way)])
    apart = np.hypot(*(fine[:, None] - points[None]).transpose(2, 0, 1))
    assert apart.min() > LIMITS.radius + 0.03


def test_there_is_no_detour_where_all_is_closed() -> None:
    assert DetourSearch(LIMITS).find(wall(-4, 4), 2.0, 0.0) is None


def test_there_is_no_detour_to_where_something_stands() -> None:
    assert DetourSearch(LIMITS).find(wall(-0.3, 0.3), 1.1, 0.0) is None


def test_a_detour_leads_out_of_the_margin() -> None:
    points = wall(-3, 3, x=-0.23)

    way = DetourSearch(LIMITS).find(points, 0.0, 1.5)
    beside = DetourSearch(LIMITS).find(points, 0.5, 1.0)

    assert way is None  # that is within the margin too
    assert beside is not None


def test_speeds_allow_to_stop() -> None:
    for distance in np.arange(0.0, 1.0, 0.01).tolist():
        speed = LIMITS.speed_before(distance)

        stopping = speed * LIMITS.latency + speed**2 / (2 * LIMITS.braking)
        assert stopping <= distance + 1e-9
        assert speed <= LIMITS.speed
    assert LIMITS.speed_before(1.0) == LIMITS.speed


def test_it_is_slower_with_less_room_and_in_bends() -> None:
    room = [LIMITS.speed_beside(clear) for clear in (0.0, 0.05, 0.1, 0.2, 1.0)]
    bends = [LIMITS.speed_in(bend) for bend in (0.0, 1.0, 2.0, 4.0)]

    assert room == sorted(room)
    assert room[0] == LIMITS.creep_speed
    assert room[-1] == LIMITS.speed
    assert bends == sorted(bends, reverse=True)
    assert bends[-1] * 4.0 < LIMITS.turn_speed


def test_circles_that_are_kept_free_are_ever_wider() -> None:
    for margin in (0.01, 0.05, 0.5):
        limits = Limits(**{**vars(LIMITS), "margin": margin})

        assert limits.radius < limits.touching < limits.tight < limits.kept


def test_the_pose_is_carried_on_by_odometry() -> None:
    it = Whereabouts(0.6, 1.5)
    it.move(0, (5.0, 5.0, math.pi / 2), 0.5, 0.0)
    it.locate(0, (1.0, 2.0, 0.0))
    for k in range(1, 11):
        it.move(k * SECOND // 50, (5.0, 5.0 + 0.01 * k, math.pi / 2), 0.5, 0.0)

    pose = it.pose(10 * SECOND // 50)
    ahead = it.pose(10 * SECOND // 50 + SECOND // 50)

    assert pose == pytest.approx((1.1, 2.0, 0.0))
    assert ahead == pytest.approx((1.11, 2.0, 0.0))


def test_an_impossible_step_of_odometry_is_a_jump() -> None:
    it = Whereabouts(0.6, 1.5)
    it.move(0, (0.0, 0.0, 0.0), 0.5, 0.0)
    it.locate(0, (1.0, 2.0, 0.0))

    assert it.move(SECOND // 50, (0.02, 0.0, 0.0), 0.5, 0.0) == ""
    assert it.move(2 * SECOND // 50, (0.5, 0.0, 0.0), 0.5, 0.0) == "jumped by 0.48 m"
    assert it.pose(2 * SECOND // 50) is None
    assert it.move(3 * SECOND // 50, (0.5, 0.0, 1.0), 0.5, 0.0) == "jumped by 0.00 m"
    assert it.move(5 * SECOND, (1.1, 0.0, 1.0), 0.5, 0.0) == ""  # a gap, but no jump
    assert it.move(5 * SECOND - 10, (9.0, 0.0, 1.0), 0.5, 0.0) == ""  # late: ignored
    assert it.odom(5 * SECOND) == (1.1, 0.0, 1.0)


def test_the_robot_is_where_odometry_says_when_time_was_set_back() -> None:
    it = Whereabouts(0.6, 1.5)
    for k in range(100):
        it.move(100 * SECOND + k * SECOND // 50, (0.01 * k, 0.0, 0.0), 0.5, 0.0)
    it.locate(100 * SECOND, (7.0, 0.0, 0.0))

    told = it.move(100 * SECOND, (1.0, 0.0, 0.0), 0.5, 0.0)
    it.move(100 * SECOND + SECOND // 50, (1.01, 0.0, 0.0), 0.5, 0.0)

    assert told == "went back in time by 2.0 s"
    assert it.odom(100 * SECOND + SECOND // 50) == (1.01, 0.0, 0.0)
    assert it.pose(100 * SECOND + SECOND // 50) is None


def test_stale_inputs_are_named_with_their_age() -> None:
    it = Freshness()

    assert it.complaint("scan", "/r/scan", 0.5, 9) == "no scan yet on /r/scan"
    it.note("scan", 10 * SECOND, 10 * SECOND)
    assert it.complaint("scan", "/r/scan", 0.5, 10 * SECOND + SECOND // 2) == ""
    reason = it.complaint("scan", "/r/scan", 0.5, 10 * SECOND + 620_000_000)
    assert reason == "no scan for 0.62 s on /r/scan"


def test_a_message_from_the_future_is_not_fresh_for_longer() -> None:
    it = Freshness()
    it.note("scan", 99 * SECOND, 10 * SECOND)

    assert it.complaint("scan", "/r/scan", 0.5, 11 * SECOND) == "no scan for 1.00 s on /r/scan"


def test_what_was_fresh_is_stale_when_time_is_set_back_until_it_comes_again() -> None:
    it = Freshness()
    it.note("scan", 100 * SECOND, 100 * SECOND)

    stale = it.complaint("scan", "/r/scan", 0.5, 40 * SECOND)
    it.note("scan", 40 * SECOND, 40 * SECOND)

    assert stale == "no scan since time was set back on /r/scan"
    assert it.complaint("scan", "/r/scan", 0.5, 40 * SECOND) == ""
    assert it.complaint("scan", "/r/scan", 0.5, 41 * SECOND) == "no scan for 1.00 s on /r/scan"
