"""The path planner on the bus: plans at once, reports missing inputs, follows its parameters."""

import math
from typing import Any

import numpy as np
import pytest

from cairn.components.path_planner.planning import PlanOutcome
from cairn.planar.messages import planar_poses
from cairn.planar.poses import Pose, compose
from cairn.runtime.lifecycle import Transition
from cairn.schemas.cairn_nav_msgs import Plan
from tests.components.path_planner.planner_on_the_bus import (
    BEGIN,
    DOOR,
    HERE,
    THERE,
    now,
    window,
)
from tests.components.path_planner.rooms import (
    as_map,
    follow,
    not_located,
    odom_at,
    pose_at,
    room,
    stand,
    wall_with_door,
)


def test_outcomes_have_the_numbers_of_the_message() -> None:
    assert all(outcome == getattr(Plan, outcome.name) for outcome in PlanOutcome)


def test_goal_is_planned_at_once(start_planner: Any) -> None:
    it = start_planner(room(DOOR))

    it.give("nav_command", follow(THERE, goal_id=7))

    (plan,) = it.taken("plan")
    (path,) = it.taken("path")
    poses = planar_poses(plan.poses)
    assert (plan.goal_id, plan.outcome, plan.header.frame_id) == (7, Plan.FOUND, "map")
    assert tuple(poses[0, :2]) == HERE[:2]
    assert tuple(poses[-1]) == pytest.approx(THERE)
    assert plan.length == pytest.approx(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    assert math.isnan(plan.nearest_x)
    assert [p.pose.position.x for p in path.poses] == poses[:, 0].tolist()


def test_missing_inputs_are_reported_and_planning_starts_when_they_arrive(
    start_planner: Any,
) -> None:
    it = start_planner(None, None)

    it.give("nav_command", follow(THERE))
    it.give("localization", not_located("no objects seen"))
    it.give("map", as_map(room()))
    it.give("localization", pose_at(HERE, BEGIN))

    plans = it.taken("plan")
    assert [plan.outcome for plan in plans] == [Plan.NOT_READY, Plan.NOT_READY, Plan.FOUND]
    assert plans[0].reason == "no map yet on /robot/map"
    assert plans[1].reason == "the robot is not located: no objects seen"


def test_repeated_command_changes_nothing_and_a_new_goal_is_planned(start_planner: Any) -> None:
    it = start_planner(room())
    for _ in range(3):
        it.give("nav_command", follow(THERE, goal_id=1))
        it.wait(0.5)
    assert len(it.taken("plan")) == 1

    it.give("nav_command", stand(goal_id=2))
    it.wait(3.0)
    assert it.taken("plan") == []

    it.give("nav_command", follow(THERE, goal_id=3))
    assert [plan.goal_id for plan in it.taken("plan")] == [3]


def test_odometry_carries_the_last_pose_forward(start_planner: Any) -> None:
    it = start_planner(room(), pose=None)
    it.give("odom", odom_at((5.0, 5.0, 1.0), BEGIN))
    it.give("localization", pose_at((1.0, 1.0, 1.0), BEGIN))
    it.wait(1.0)
    it.give("odom", odom_at((5.0, 5.5, 1.0), BEGIN + 1.0))

    it.give("nav_command", follow(THERE))

    poses = planar_poses(it.taken("plan")[0].poses)
    assert poses[0, :2] == pytest.approx((1.0, 1.5))


def driven_away(start_planner: Any) -> Any:
    """A robot driving to THERE, 3.8 m from the start of its odometry."""
    it = start_planner(room(), pose=None)
    it.give("odom", odom_at((3.0, 2.3, 0.0), BEGIN))
    it.give("localization", pose_at((4.0, 4.0, 0.0), BEGIN))
    it.give("nav_command", follow(THERE))
    assert [plan.outcome for plan in it.taken("plan")] == [Plan.FOUND]
    return it


def test_pose_is_not_carried_forward_across_an_odometry_jump(
    start_planner: Any, caplog: pytest.LogCaptureFixture
) -> None:
    it = driven_away(start_planner)

    it.wait(2.0)
    it.give("odom", odom_at((0.0, 0.0, 0.0), BEGIN + 2.0))
    it.give("localization", pose_at((4.0, 4.0, 0.0), BEGIN + 0.5))  # from before the jump, and late
    it.wait(3.0)
    kept = it.taken("plan")
    it.give("localization", pose_at((4.5, 4.5, 0.0), now(it)))

    assert kept == []
    assert "waiting for a new localization estimate" in caplog.text
    assert "off the path" not in caplog.text
    assert it.taken("plan") == []  # the known path is good


def test_goal_after_an_odometry_jump_waits_for_a_pose(start_planner: Any) -> None:
    it = driven_away(start_planner)

    it.wait(2.0)
    it.give("odom", odom_at((0.0, 0.0, 0.0), BEGIN + 2.0))
    it.give("nav_command", follow(THERE, goal_id=2))
    it.give("localization", pose_at((4.0, 4.0, 0.0), BEGIN + 1.9))
    (refused,) = it.taken("plan")
    it.give("odom", odom_at((0.1, 0.0, 0.0), now(it) + 0.1))
    it.give("localization", pose_at((4.5, 4.5, 0.0), BEGIN + 2.0))

    assert refused.outcome == Plan.NOT_READY
    assert (
        refused.reason
        == "no localization estimate on /robot/localization since odometry on /robot/odom restarted"
    )
    (found,) = it.taken("plan")
    assert tuple(planar_poses(found.poses)[0, :2]) == (4.5, 4.5)


def test_pose_after_the_jump_that_arrives_before_odometry_counts(start_planner: Any) -> None:
    it = driven_away(start_planner)
    it.wait(2.0)
    it.give("localization", pose_at((5.0, 5.0, 0.0), BEGIN + 2.0))

    it.give("odom", odom_at((0.0, 0.0, 0.0), BEGIN + 1.98))
    it.give("nav_command", follow(THERE, goal_id=2))

    (plan,) = it.taken("plan")
    assert tuple(planar_poses(plan.poses)[0, :2]) == (5.0, 5.0)


def test_pose_from_before_a_time_reset_is_not_used(start_planner: Any) -> None:
    it = driven_away(start_planner)

    it.give("odom", odom_at((3.0, 2.3, 0.0), BEGIN - 50.0))
    it.give("nav_command", follow(THERE, goal_id=2))
    it.give("localization", pose_at((4.5, 4.5, 0.0), BEGIN - 50.0))

    refused, found = it.taken("plan")
    assert refused.outcome == Plan.NOT_READY
    assert tuple(planar_poses(found.poses)[0, :2]) == (4.5, 4.5)


@pytest.mark.parametrize(
    ("seconds", "step"), [(0.05, (0.15, 0.0, 0.3)), (1.0, (1.0, 0.0, 2.0))], ids=["fast", "seldom"]
)
def test_fast_robots_and_rare_odometry_are_no_jump(
    start_planner: Any, seconds: float, step: Pose
) -> None:
    it = driven_away(start_planner)

    it.wait(seconds)
    it.give("odom", odom_at(compose((3.0, 2.3, 0.0), step), now(it)))
    it.give("nav_command", follow(THERE, goal_id=2))

    (plan,) = it.taken("plan")
    assert planar_poses(plan.poses)[0, :2] == pytest.approx((4.0 + step[0], 4.0))


def test_restarted_planner_continues_with_the_latched_goal(start_planner: Any) -> None:
    it = start_planner(room())
    it.give("nav_command", follow(THERE, goal_id=4))
    it.taken("plan")

    for step in ("DEACTIVATE", "CLEANUP", "CONFIGURE", "ACTIVATE"):
        it.runtime.transition(Transition[step])
    it.wait(0.5)
    it.give("localization", pose_at((2.0, 2.0, 0.0), now(it)))

    *refused, found = it.taken("plan")
    assert {(plan.goal_id, plan.outcome) for plan in refused} == {(4, Plan.NOT_READY)}
    assert (found.goal_id, found.outcome) == (4, Plan.FOUND)
    assert tuple(planar_poses(found.poses)[0, :2]) == (2.0, 2.0)


def test_map_update_outside_the_map_is_logged_and_ignored(
    start_planner: Any, caplog: pytest.LogCaptureFixture
) -> None:
    it = start_planner(room())

    it.give("map_updates", window((8.0, 0.0, 10.0, 1.0), 100))

    assert "a map update outside the map: 40 x 20 cells at column 160, row 0" in caplog.text


def test_cost_parameters_change_at_run_time(start_planner: Any) -> None:
    it = start_planner(room(wall_with_door(0.6)))
    it.give("nav_command", follow(THERE))
    assert it.taken("plan")[0].outcome == Plan.FOUND

    it.runtime.set_parameters({"radius": 0.4})
    it.wait(1.0)
    it.give("localization", pose_at(HERE, now(it)))

    assert [plan.outcome for plan in it.taken("plan")] == [Plan.UNREACHABLE]
