"""When the path planner replans: obstacles on the path, a robot off the path, a shorter path."""

from functools import partial

import pytest

from cairn import SECOND, from_ns
from cairn.components.path_planner.component import PathPlanner
from cairn.planar.messages import planar_poses
from cairn.schemas.cairn_nav_msgs import MotionStatus, Plan
from cairn.schemas.rosgraph_msgs import Clock
from cairn.testing.lockstep import ComponentHarness
from tests.components.path_planner.planner_harness import (
    DOOR,
    THERE,
    distance_to,
    map_update,
    scan_standing,
    start_planner,
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
from tests.wording import assert_words


def test_free_path_is_kept() -> None:
    grid = room(DOOR)
    planner = start_planner(grid)
    planner.publish("nav_command", follow(THERE))

    scan_standing(planner, grid, 4.0)

    assert len(planner.take("plan")) == 1


def test_path_avoids_a_box_that_only_the_scanner_sees_until_it_is_forgotten() -> None:
    box = (2.5, 1.7, 2.9, 2.4)
    planner = start_planner(room(DOOR, size=(9.0, 7.0)), pose=(1.0, 1.8, 0.0))
    here = (1.0, 1.8, 0.0)
    planner.publish("nav_command", follow((4.0, 2.3, 0.0)))
    (first,) = planner.take("plan")
    assert distance_to(first, [box]) < 0.1

    scan_standing(planner, room([*DOOR, box]), 0.5, here)
    (around,) = planner.take("plan")
    scan_standing(planner, room([*DOOR, box]), 3.0, here)
    assert planner.take("plan") == []
    scan_standing(planner, room(DOOR), 3.0, here)

    assert around.outcome == Plan.FOUND
    assert distance_to(around, [box]) > 0.19
    back = planner.take("plan")
    assert len(back) <= 1
    assert all(plan.length < around.length for plan in back)


def test_obstacles_seen_for_an_earlier_goal_are_not_avoided() -> None:
    box = (2.5, 1.7, 2.9, 2.4)
    here, there = (1.0, 1.8, 0.0), (4.0, 2.3, 0.0)
    planner = start_planner(room(), pose=here)
    planner.publish("nav_command", follow(there, command_id=1))
    scan_standing(planner, room([box]), 0.5, here)
    planner.publish("nav_command", stand(command_id=2))
    planner.run_for(5.0)
    planner.take("plan")

    planner.publish("nav_command", follow(there, command_id=3))

    assert distance_to(planner.take("plan")[0], [box]) < 0.1


def test_scan_waits_for_the_odometry_of_its_time() -> None:
    there, obstacle = (4.0, 1.0, 0.0), (2.2, 0.8, 2.5, 1.4)
    planner = start_planner(room())
    planner.publish("odom", odom_at((0.0, 0.0, 0.0), planner.now))
    planner.publish("nav_command", follow(there))
    assert distance_to(planner.take("plan")[-1], [obstacle]) < 0.1

    # The robot turns meanwhile: the last odometry would place the obstacle beside the path.
    planner.run_for(0.2)
    planner.publish("scan", scan_of(room([obstacle]), (1.0, 1.0, 0.8), planner.now))
    assert planner.take("plan") == []
    planner.publish("odom", odom_at((0.0, 0.0, 0.8), planner.now))

    assert distance_to(planner.take("plan")[-1], [obstacle]) > 0.19


def test_odometry_out_of_order_is_no_time_reset(caplog: pytest.LogCaptureFixture) -> None:
    planner = start_planner(room())
    planner.run_for(1.0)
    for ago_s in (0.0, 0.3, 0.1, 0.45, 0.2):
        planner.publish("odom", odom_at((0.0, 0.0, 0.0), planner.now - ago_s))

    assert "odometry on" not in caplog.text


def test_time_reset_forgets_old_obstacles_and_accepts_new_ones(
    caplog: pytest.LogCaptureFixture,
) -> None:
    before, after = (2.5, 1.7, 2.9, 2.4), (2.5, 1.0, 2.9, 1.7)
    here = (1.0, 1.8, 0.0)
    planner = ComponentHarness(PathPlanner, simulated_time=True)
    planner.publish("map", as_map(room()))

    def plan_after_scans(box: Box, begin: float) -> Plan:
        """Return the last plan after half a second of scans of a room with a box."""
        for k in range(5):
            time = begin + 0.1 * k
            planner.publish("clock", Clock(clock=from_ns(round(time * SECOND))))
            planner.publish("odom", odom_at((0.0, 0.0, 0.0), time))
            planner.publish("localization", pose_at(here, time))
            planner.publish("nav_command", follow((4.0, 2.3, 0.0)))
            planner.publish("scan", scan_of(room([box]), here, time))
        plan: Plan = planner.take("plan")[-1]
        return plan

    first, second = plan_after_scans(before, 1000.0), plan_after_scans(after, 400.0)

    assert distance_to(first, [before]) > 0.19
    assert distance_to(second, [after]) > 0.19
    assert distance_to(second, [before]) < 0.19
    assert caplog.text.count("odometry on /robot/odom went back in time") == 1


def test_door_blocked_by_a_person_is_reported_until_the_person_leaves() -> None:
    person_box = (4.4, 2.3, 4.7, 2.6)
    planner = start_planner(room(DOOR), pose=(2.0, 2.4, 0.0))
    here = (2.0, 2.4, 0.0)
    planner.publish("nav_command", follow((7.0, 2.4, 0.0)))
    assert planner.take("plan")[0].outcome == Plan.FOUND

    scan_standing(planner, room([*DOOR, person_box]), 3.0, here)
    refused = planner.take("plan")
    scan_standing(planner, room(DOOR), 2.1, here)
    again = planner.take("plan")

    assert {plan.outcome for plan in refused} == {Plan.UNREACHABLE}
    assert refused[-1].reason.startswith("blocked by an obstacle that the scanner sees at (4.")
    assert refused[-1].nearest_x == pytest.approx(4.1, abs=0.2)
    assert len(refused[-1].poses) == 0
    assert [plan.outcome for plan in again] == [Plan.FOUND]


def test_path_closed_by_a_map_update_is_replanned() -> None:
    planner = start_planner(room())
    planner.publish("nav_command", follow(THERE))
    planner.take("plan")
    box = (4.0, 3.0, 5.0, 4.0)

    planner.publish("map_updates", map_update((0.5, 5.5, 1.0, 6.0), 100))
    assert planner.take("plan") == []
    planner.publish("map_updates", map_update(box, 100))

    (around,) = planner.take("plan")
    assert distance_to(around, [box]) > 0.19


def test_obstacle_in_the_margin_does_not_break_the_path() -> None:
    planner = start_planner(room(), pose=(1.0, 1.025, 0.0))
    planner.publish("nav_command", follow((8.0, 1.025, 0.0)))
    planner.take("plan")

    planner.publish(
        "map_updates", map_update((4.0, 1.25, 5.0, 1.6), 100)
    )  # centers 0.25 m off: closed
    planner.run_for(2.0)
    assert planner.take("plan") == []
    planner.publish("map_updates", map_update((4.0, 1.2, 5.0, 1.25), 100))

    assert len(planner.take("plan")) == 1


def test_path_opened_by_a_map_update_is_taken_if_clearly_shorter() -> None:
    planner = start_planner(room([(3.0, 0.0, 3.1, 6.0)]), pose=(1.5, 3.0, 0.0))
    planner.publish("nav_command", follow((7.0, 3.0, 0.0)))
    (long,) = planner.take("plan")

    planner.publish("map_updates", map_update((3.0, 2.0, 3.1, 4.0), 0))
    planner.run_for(1.5)
    (short,) = planner.take("plan")
    planner.publish("map_updates", map_update((3.0, 2.0, 3.1, 2.5), 100))
    planner.run_for(3.0)

    assert long.length > short.length + 2
    assert planner.take("plan") == []


TWO_DOORS = [(4.5, 0.0, 4.6, 2.0), (4.5, 2.8, 4.6, 5.2), (4.5, 6.0, 4.6, 7.0)]
BEYOND = (8.0, 2.4, 0.0)


def stand_blocked(
    planner: ComponentHarness[PathPlanner], duration: float, state: int = MotionStatus.BLOCKED
) -> None:
    """Let motion control report for some time, five times per second, that the robot is blocked."""
    for _ in range(round(duration * 5)):
        planner.run_for(0.2)
        planner.publish("motion_status", MotionStatus(command_id=1, state=state))


@pytest.mark.parametrize(
    ("state", "seconds"), [(MotionStatus.BLOCKED, 2.6), (MotionStatus.MOVING, 6.6)]
)
def test_stuck_robot_gets_another_path_and_keeps_it(state: int, seconds: float) -> None:
    planner = start_planner(room(TWO_DOORS), pose=(4.0, 2.4, 0.0))
    planner.publish("nav_command", follow(BEYOND))
    (straight,) = planner.take("plan")

    stand_blocked(planner, seconds, state)
    (around,) = planner.take("plan")
    planner.run_for(20.0)

    assert straight.length < 4.1
    assert planar_poses(around.poses)[:, 1].max() > 5.2
    assert planner.take("plan") == []


def test_stuck_robot_without_an_alternative_keeps_its_path() -> None:
    planner = start_planner(room(DOOR), pose=(4.0, 2.4, 0.0))
    planner.publish("nav_command", follow(BEYOND))
    planner.take("plan")

    stand_blocked(planner, 10.0)
    kept = planner.take("plan")
    planner.publish("nav_command", stand(command_id=2))
    planner.publish("nav_command", follow(BEYOND, command_id=3))

    assert kept == []
    assert [plan.outcome for plan in planner.take("plan")] == [Plan.FOUND]


def test_robot_stopped_by_a_missing_input_is_not_stuck() -> None:
    planner = start_planner(room(TWO_DOORS), pose=(4.0, 2.4, 0.0))
    planner.publish("nav_command", follow(BEYOND))
    planner.take("plan")

    stand_blocked(planner, 10.0, MotionStatus.STOPPED)

    assert planner.take("plan") == []


def test_blocked_path_is_not_taken_again_when_it_is_out_of_view() -> None:
    here, blocking = (3.0, 2.4, 0.0), (4.3, 2.0, 4.5, 2.8)
    planner = start_planner(room(TWO_DOORS), pose=here)
    planner.publish("nav_command", follow(BEYOND))
    scan_standing(planner, room([*TWO_DOORS, blocking]), 0.5, here)
    around = planner.take("plan")[-1]

    planner.run_for(20.0)  # not seen any more, neither present nor gone
    kept = planner.take("plan")
    scan_standing(planner, room(TWO_DOORS), 2.0, here)

    assert planar_poses(around.poses)[:, 1].max() > 5.2
    assert kept == []
    assert planner.take("plan")[-1].length < 5.1


def test_grown_map_is_planned_on() -> None:
    planner = start_planner(room(size=(5.0, 7.0)))
    planner.publish("nav_command", follow(THERE))
    (outside,) = planner.take("plan")

    planner.publish("map", as_map(room()))
    planner.run_for(1.5)

    assert outside.outcome == Plan.OUTSIDE_MAP
    assert [plan.outcome for plan in planner.take("plan")] == [Plan.FOUND]


def test_wall_across_the_path_is_noticed_in_a_map_with_another_origin() -> None:
    planner = start_planner(room())
    planner.publish("nav_command", follow(THERE))
    (straight,) = planner.take("plan")

    grown = partial(room, size=(14.0, 12.0), origin=(-5.0, -5.0, 0.0))
    planner.publish("map", as_map(grown([(1.0, 1.0, 4.0, 4.0)])))
    assert planner.take("plan") == []  # the path is as free as it was
    planner.publish("map", as_map(grown([(9.5, 5.7, 9.6, 12.0)])))  # at x = 4.5, from y = 0.7

    (around,) = planner.take("plan")
    assert around.outcome == Plan.FOUND
    assert around.length > straight.length + 0.5


def test_path_outside_a_shrunk_map_is_replanned_at_once() -> None:
    planner = start_planner(room(), pose=(1.0, 1.5, 0.0))
    planner.publish("nav_command", follow((8.0, 1.5, 0.0)))
    planner.take("plan")

    planner.publish("map", as_map(room(size=(9.0, 3.0), origin=(-5.0, 0.0, 0.0))))  # to x = 4

    (plan,) = planner.take("plan")
    assert plan.outcome == Plan.OUTSIDE_MAP
    assert_words(plan.reason, "goal (8.00, 1.50)", "outside the map")


def test_robot_outside_the_map_gets_a_path_when_it_is_back() -> None:
    planner = start_planner(room(), pose=(-0.1, 3.0, 0.0))
    planner.publish("nav_command", follow(THERE))
    (off,) = planner.take("plan")

    planner.publish("localization", pose_at((1.0, 3.0, 0.0), planner.now))
    planner.run_for(1.5)

    assert off.outcome == Plan.START_BLOCKED
    assert_words(off.reason, "(-0.10, 3.00)", "outside the map")
    assert [plan.outcome for plan in planner.take("plan")] == [Plan.FOUND]


def test_robot_that_left_its_path_gets_a_new_one() -> None:
    planner = start_planner(room())
    planner.publish("nav_command", follow((8.0, 1.0, 0.0)))
    planner.take("plan")

    planner.run_for(1.0)
    planner.publish("localization", pose_at((3.0, 1.4, 0.0), planner.now))
    assert planner.take("plan") == []
    planner.run_for(1.0)
    planner.publish("localization", pose_at((3.0, 1.7, 0.0), planner.now))

    (plan,) = planner.take("plan")
    assert tuple(planar_poses(plan.poses)[0, :2]) == (3.0, 1.7)


def test_path_out_of_an_obstacle_is_kept() -> None:
    here = (1.2, 1.0, 0.0)
    planner = start_planner(room([(0.8, 0.8, 1.3, 1.2)]), pose=here)
    planner.publish("nav_command", follow(THERE))

    for _ in range(10):
        planner.run_for(0.3)
        planner.publish("localization", pose_at(here, planner.now))

    assert [plan.outcome for plan in planner.take("plan")] == [Plan.FOUND]


def test_scans_of_a_lost_robot_are_not_used() -> None:
    planner = start_planner(room(DOOR))
    planner.publish("nav_command", follow(THERE))
    planner.publish("localization", pose_at((1.0, 1.0, 0.0), planner.now, health=0.1))
    scan_standing(planner, room([*DOOR, (2.0, 1.0, 2.4, 2.0)]), 1.0, health=0.1)

    assert len(planner.take("plan")) == 1
