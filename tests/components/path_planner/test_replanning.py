"""When the path planner replans: obstacles on the path, a robot off the path, a shorter path."""

from functools import partial
from typing import Any

import pytest

from cairn import LATCHED, SECOND, SENSOR, from_ns
from cairn.components.path_planner.component import PathPlanner
from cairn.planar.messages import planar_poses
from cairn.schemas.cairn_nav_msgs import MotionStatus, Plan
from cairn.schemas.rosgraph_msgs import Clock
from tests.cairn.runtime.running import Lockstep, taken
from tests.components.path_planner.planner_on_the_bus import (
    DOOR,
    THERE,
    clear_of,
    now,
    stay,
    window,
)
from tests.components.path_planner.rooms import (
    Box,
    as_map,
    follow,
    odom_at,
    pose_at,
    room,
    scan_of,
    stand,
)


def test_free_path_is_kept(start_planner: Any) -> None:
    grid = room(DOOR)
    it = start_planner(grid)
    it.give("nav_command", follow(THERE))

    stay(it, grid, 4.0)

    assert len(it.taken("plan")) == 1


def test_path_avoids_a_box_that_only_the_scanner_sees_until_it_is_forgotten(
    start_planner: Any,
) -> None:
    box = (2.5, 1.7, 2.9, 2.4)
    it = start_planner(room(DOOR, size=(9.0, 7.0)), pose=(1.0, 1.8, 0.0))
    here = (1.0, 1.8, 0.0)
    it.give("nav_command", follow((4.0, 2.3, 0.0)))
    (first,) = it.taken("plan")
    assert clear_of(first, [box]) < 0.1

    stay(it, room([*DOOR, box]), 0.5, here)
    (around,) = it.taken("plan")
    stay(it, room([*DOOR, box]), 3.0, here)
    assert it.taken("plan") == []
    stay(it, room(DOOR), 3.0, here)

    assert around.outcome == Plan.FOUND
    assert clear_of(around, [box]) > 0.19
    back = it.taken("plan")
    assert len(back) <= 1
    assert all(plan.length < around.length for plan in back)


def test_obstacles_seen_for_an_earlier_goal_are_not_avoided(start_planner: Any) -> None:
    box = (2.5, 1.7, 2.9, 2.4)
    here, there = (1.0, 1.8, 0.0), (4.0, 2.3, 0.0)
    it = start_planner(room(), pose=here)
    it.give("nav_command", follow(there, goal_id=1))
    stay(it, room([box]), 0.5, here)
    it.give("nav_command", stand(goal_id=2))
    it.wait(5.0)
    it.taken("plan")

    it.give("nav_command", follow(there, goal_id=3))

    assert clear_of(it.taken("plan")[0], [box]) < 0.1


def test_time_reset_forgets_old_obstacles_and_accepts_new_ones(
    caplog: pytest.LogCaptureFixture,
) -> None:
    before, after = (2.5, 1.7, 2.9, 2.4), (2.5, 1.0, 2.9, 1.7)
    here = (1.0, 1.8, 0.0)
    lockstep = Lockstep()
    lockstep.add(PathPlanner, simulated_time=True).activate()
    plans = lockstep.read("plan", Plan)
    lockstep.publish("map", as_map(room()), qos=LATCHED)

    def add_scan(box: Box, begin: float) -> Plan:
        """The last plan after half a second of scans of a room with a box."""
        for k in range(5):
            time = begin + 0.1 * k
            lockstep.publish("clock", Clock(clock=from_ns(round(time * SECOND))))
            lockstep.publish("odom", odom_at((0.0, 0.0, 0.0), time))
            lockstep.publish("localization", pose_at(here, time))
            lockstep.publish("nav_command", follow((4.0, 2.3, 0.0)), qos=LATCHED)
            lockstep.run()
            lockstep.publish("scan", scan_of(room([box]), here, time), qos=SENSOR)
            lockstep.run()
        plan: Plan = taken(plans)[-1]
        return plan

    first, second = add_scan(before, 1000.0), add_scan(after, 400.0)

    assert clear_of(first, [before]) > 0.19
    assert clear_of(second, [after]) > 0.19
    assert clear_of(second, [before]) < 0.19
    assert caplog.text.count("odometry on /robot/odom went back in time") == 1


def test_door_blocked_by_a_person_is_reported_until_the_person_leaves(start_planner: Any) -> None:
    person_box = (4.4, 2.3, 4.7, 2.6)
    it = start_planner(room(DOOR), pose=(2.0, 2.4, 0.0))
    here = (2.0, 2.4, 0.0)
    it.give("nav_command", follow((7.0, 2.4, 0.0)))
    assert it.taken("plan")[0].outcome == Plan.FOUND

    stay(it, room([*DOOR, person_box]), 3.0, here)
    refused = it.taken("plan")
    stay(it, room(DOOR), 2.1, here)
    again = it.taken("plan")

    assert {plan.outcome for plan in refused} == {Plan.UNREACHABLE}
    assert refused[-1].reason.startswith("blocked by an obstacle that the scanner sees at (4.")
    assert refused[-1].nearest_x == pytest.approx(4.1, abs=0.2)
    assert len(refused[-1].poses) == 0
    assert [plan.outcome for plan in again] == [Plan.FOUND]


def test_path_closed_by_a_map_update_is_replanned(start_planner: Any) -> None:
    it = start_planner(room())
    it.give("nav_command", follow(THERE))
    it.taken("plan")
    box = (4.0, 3.0, 5.0, 4.0)

    it.give("map_updates", window((0.5, 5.5, 1.0, 6.0), 100))
    assert it.taken("plan") == []
    it.give("map_updates", window(box, 100))

    (around,) = it.taken("plan")
    assert clear_of(around, [box]) > 0.19


def test_obstacle_in_the_margin_does_not_break_the_path(start_planner: Any) -> None:
    it = start_planner(room(), pose=(1.0, 1.025, 0.0))
    it.give("nav_command", follow((8.0, 1.025, 0.0)))
    it.taken("plan")

    it.give("map_updates", window((4.0, 1.25, 5.0, 1.6), 100))  # centers 0.25 m off: closed
    it.wait(2.0)
    assert it.taken("plan") == []
    it.give("map_updates", window((4.0, 1.2, 5.0, 1.25), 100))

    assert len(it.taken("plan")) == 1


def test_path_opened_by_a_map_update_is_taken_if_clearly_shorter(start_planner: Any) -> None:
    it = start_planner(room([(3.0, 0.0, 3.1, 6.0)]), pose=(1.5, 3.0, 0.0))
    it.give("nav_command", follow((7.0, 3.0, 0.0)))
    (long,) = it.taken("plan")

    it.give("map_updates", window((3.0, 2.0, 3.1, 4.0), 0))
    it.wait(1.5)
    (short,) = it.taken("plan")
    it.give("map_updates", window((3.0, 2.0, 3.1, 2.5), 100))
    it.wait(3.0)

    assert long.length > short.length + 2
    assert it.taken("plan") == []


TWO_DOORS = [(4.5, 0.0, 4.6, 2.0), (4.5, 2.8, 4.6, 5.2), (4.5, 6.0, 4.6, 7.0)]
BEYOND = (8.0, 2.4, 0.0)


def stand_blocked(it: Any, duration: float, state: int = MotionStatus.BLOCKED) -> None:
    """Let motion control report for some time, five times per second, that the robot is blocked."""
    for _ in range(round(duration * 5)):
        it.wait(0.2)
        it.give("motion_status", MotionStatus(goal_id=1, state=state))


@pytest.mark.parametrize(
    ("state", "seconds"), [(MotionStatus.BLOCKED, 2.6), (MotionStatus.MOVING, 6.6)]
)
def test_stuck_robot_gets_another_path_and_keeps_it(
    start_planner: Any, state: int, seconds: float
) -> None:
    it = start_planner(room(TWO_DOORS), pose=(4.0, 2.4, 0.0))
    it.give("nav_command", follow(BEYOND))
    (straight,) = it.taken("plan")

    stand_blocked(it, seconds, state)
    (around,) = it.taken("plan")
    it.wait(20.0)

    assert straight.length < 4.1
    assert planar_poses(around.poses)[:, 1].max() > 5.2
    assert it.taken("plan") == []


def test_stuck_robot_without_an_alternative_keeps_its_path(start_planner: Any) -> None:
    it = start_planner(room(DOOR), pose=(4.0, 2.4, 0.0))
    it.give("nav_command", follow(BEYOND))
    it.taken("plan")

    stand_blocked(it, 10.0)
    kept = it.taken("plan")
    it.give("nav_command", stand(goal_id=2))
    it.give("nav_command", follow(BEYOND, goal_id=3))

    assert kept == []
    assert [plan.outcome for plan in it.taken("plan")] == [Plan.FOUND]


def test_robot_stopped_by_a_missing_input_is_not_stuck(
    start_planner: Any,
) -> None:
    it = start_planner(room(TWO_DOORS), pose=(4.0, 2.4, 0.0))
    it.give("nav_command", follow(BEYOND))
    it.taken("plan")

    stand_blocked(it, 10.0, MotionStatus.STOPPED)

    assert it.taken("plan") == []


def test_blocked_path_is_not_taken_again_when_it_is_out_of_view(
    start_planner: Any,
) -> None:
    here, blocking = (3.0, 2.4, 0.0), (4.3, 2.0, 4.5, 2.8)
    it = start_planner(room(TWO_DOORS), pose=here)
    it.give("nav_command", follow(BEYOND))
    stay(it, room([*TWO_DOORS, blocking]), 0.5, here)
    around = it.taken("plan")[-1]

    it.wait(20.0)  # not seen any more, neither present nor gone
    kept = it.taken("plan")
    stay(it, room(TWO_DOORS), 2.0, here)

    assert planar_poses(around.poses)[:, 1].max() > 5.2
    assert kept == []
    assert it.taken("plan")[-1].length < 5.1


def test_grown_map_is_planned_on(start_planner: Any) -> None:
    it = start_planner(room(size=(5.0, 7.0)))
    it.give("nav_command", follow(THERE))
    (outside,) = it.taken("plan")

    it.give("map", as_map(room()))
    it.wait(1.5)

    assert outside.outcome == Plan.OUTSIDE_MAP
    assert [plan.outcome for plan in it.taken("plan")] == [Plan.FOUND]


def test_wall_across_the_path_is_noticed_in_a_map_with_another_origin(start_planner: Any) -> None:
    it = start_planner(room())
    it.give("nav_command", follow(THERE))
    (straight,) = it.taken("plan")

    grown = partial(room, size=(14.0, 12.0), origin=(-5.0, -5.0, 0.0))
    it.give("map", as_map(grown([(1.0, 1.0, 4.0, 4.0)])))
    assert it.taken("plan") == []  # the path is as free as it was
    it.give("map", as_map(grown([(9.5, 5.7, 9.6, 12.0)])))  # at x = 4.5, from y = 0.7

    (around,) = it.taken("plan")
    assert around.outcome == Plan.FOUND
    assert around.length > straight.length + 0.5


def test_path_outside_a_shrunk_map_is_replanned_at_once(start_planner: Any) -> None:
    it = start_planner(room(), pose=(1.0, 1.5, 0.0))
    it.give("nav_command", follow((8.0, 1.5, 0.0)))
    it.taken("plan")

    it.give("map", as_map(room(size=(9.0, 3.0), origin=(-5.0, 0.0, 0.0))))  # to x = 4

    (plan,) = it.taken("plan")
    assert plan.outcome == Plan.OUTSIDE_MAP
    assert "the goal (8.00, 1.50) is outside the map" in plan.reason


def test_robot_outside_the_map_gets_a_path_when_it_is_back(start_planner: Any) -> None:
    it = start_planner(room(), pose=(-0.1, 3.0, 0.0))
    it.give("nav_command", follow(THERE))
    (off,) = it.taken("plan")

    it.give("localization", pose_at((1.0, 3.0, 0.0), now(it)))
    it.wait(1.5)

    assert off.outcome == Plan.START_BLOCKED
    assert off.reason == "the robot at (-0.10, 3.00) is outside the map"
    assert [plan.outcome for plan in it.taken("plan")] == [Plan.FOUND]


def test_robot_that_left_its_path_gets_a_new_one(start_planner: Any) -> None:
    it = start_planner(room())
    it.give("nav_command", follow((8.0, 1.0, 0.0)))
    it.taken("plan")

    it.wait(1.0)
    it.give("localization", pose_at((3.0, 1.4, 0.0), now(it)))
    assert it.taken("plan") == []
    it.wait(1.0)
    it.give("localization", pose_at((3.0, 1.7, 0.0), now(it)))

    (plan,) = it.taken("plan")
    assert tuple(planar_poses(plan.poses)[0, :2]) == (3.0, 1.7)


def test_path_out_of_an_obstacle_is_kept(start_planner: Any) -> None:
    here = (1.2, 1.0, 0.0)
    it = start_planner(room([(0.8, 0.8, 1.3, 1.2)]), pose=here)
    it.give("nav_command", follow(THERE))

    for _ in range(10):
        it.wait(0.3)
        it.give("localization", pose_at(here, now(it)))

    assert [plan.outcome for plan in it.taken("plan")] == [Plan.FOUND]


def test_scans_of_a_lost_robot_are_not_used(start_planner: Any) -> None:
    it = start_planner(room(DOOR))
    it.give("nav_command", follow(THERE))
    it.give("localization", pose_at((1.0, 1.0, 0.0), now(it), health=0.1))
    stay(it, room([*DOOR, (2.0, 1.0, 2.4, 2.0)]), 1.0, health=0.1)

    assert len(it.taken("plan")) == 1
