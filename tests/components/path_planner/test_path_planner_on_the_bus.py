"""The path planner on the bus: plans at once, reports missing inputs, follows its parameters."""

import math
from typing import Any

import numpy as np
import pytest

from cairn.components.path_planner.planning import PlanOutcome
from cairn.planar.messages import planar_poses
from cairn.planar.poses import Pose, compose
from cairn.schemas.cairn_nav_msgs import Plan
from tests.components.path_planner.planner_harness import (
    BEGIN,
    DOOR,
    HERE,
    THERE,
    map_update,
    start_planner,
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
from tests.wording import assert_words


def test_outcomes_have_the_numbers_of_the_message() -> None:
    assert all(outcome == getattr(Plan, outcome.name) for outcome in PlanOutcome)


def test_goal_is_planned_at_once() -> None:
    planner = start_planner(room(DOOR))

    planner.publish("nav_command", follow(THERE, command_id=7))

    (plan,) = planner.take("plan")
    (path,) = planner.take("path")
    poses = planar_poses(plan.poses)
    assert (plan.command_id, plan.outcome, plan.header.frame_id) == (7, Plan.FOUND, "map")
    assert tuple(poses[0, :2]) == HERE[:2]
    assert tuple(poses[-1]) == pytest.approx(THERE)
    assert plan.length == pytest.approx(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    assert math.isnan(plan.nearest_x)
    assert [p.pose.position.x for p in path.poses] == poses[:, 0].tolist()


def test_missing_inputs_are_reported_and_planning_starts_when_they_arrive() -> None:
    planner = start_planner(None, None)

    planner.publish("nav_command", follow(THERE))
    planner.publish("localization", not_located("no objects seen"))
    planner.publish("map", as_map(room()))
    planner.publish("localization", pose_at(HERE, BEGIN))

    plans = planner.take("plan")
    assert [plan.outcome for plan in plans] == [Plan.NOT_READY, Plan.NOT_READY, Plan.FOUND]
    assert_words(plans[0].reason, "no map yet", "/robot/map")
    assert_words(plans[1].reason, "not located", "no objects seen")


def test_repeated_command_changes_nothing_and_a_new_goal_is_planned() -> None:
    planner = start_planner(room())
    for _ in range(3):
        planner.publish("nav_command", follow(THERE, command_id=1))
        planner.run_for(0.5)
    assert len(planner.take("plan")) == 1

    planner.publish("nav_command", stand(command_id=2))
    planner.run_for(3.0)
    assert planner.take("plan") == []

    planner.publish("nav_command", follow(THERE, command_id=3))
    assert [plan.command_id for plan in planner.take("plan")] == [3]


def test_odometry_carries_the_last_pose_forward() -> None:
    planner = start_planner(room(), pose=None)
    planner.publish("odom", odom_at((5.0, 5.0, 1.0), BEGIN))
    planner.publish("localization", pose_at((1.0, 1.0, 1.0), BEGIN))
    planner.run_for(1.0)
    planner.publish("odom", odom_at((5.0, 5.5, 1.0), BEGIN + 1.0))

    planner.publish("nav_command", follow(THERE))

    poses = planar_poses(planner.take("plan")[0].poses)
    assert poses[0, :2] == pytest.approx((1.0, 1.5))


def driven_away() -> Any:
    """A robot driving to THERE, 3.8 m from the start of its odometry."""
    planner = start_planner(room(), pose=None)
    planner.publish("odom", odom_at((3.0, 2.3, 0.0), BEGIN))
    planner.publish("localization", pose_at((4.0, 4.0, 0.0), BEGIN))
    planner.publish("nav_command", follow(THERE))
    assert [plan.outcome for plan in planner.take("plan")] == [Plan.FOUND]
    return planner


def test_pose_is_not_carried_forward_across_an_odometry_jump(
    caplog: pytest.LogCaptureFixture,
) -> None:
    planner = driven_away()

    planner.run_for(2.0)
    planner.publish("odom", odom_at((0.0, 0.0, 0.0), BEGIN + 2.0))
    planner.publish(
        "localization", pose_at((4.0, 4.0, 0.0), BEGIN + 0.5)
    )  # from before the jump, and late
    planner.run_for(3.0)
    kept = planner.take("plan")
    planner.publish("localization", pose_at((4.5, 4.5, 0.0), planner.now))

    assert kept == []
    assert "waiting for a new localization estimate" in caplog.text
    assert "off the path" not in caplog.text
    assert planner.take("plan") == []  # the known path is good


def test_goal_after_an_odometry_jump_waits_for_a_pose() -> None:
    planner = driven_away()

    planner.run_for(2.0)
    planner.publish("odom", odom_at((0.0, 0.0, 0.0), BEGIN + 2.0))
    planner.publish("nav_command", follow(THERE, command_id=2))
    planner.publish("localization", pose_at((4.0, 4.0, 0.0), BEGIN + 1.9))
    (refused,) = planner.take("plan")
    planner.publish("odom", odom_at((0.1, 0.0, 0.0), planner.now + 0.1))
    planner.publish("localization", pose_at((4.5, 4.5, 0.0), BEGIN + 2.0))

    assert refused.outcome == Plan.NOT_READY
    assert_words(refused.reason, "/robot/localization", "/robot/odom")
    (found,) = planner.take("plan")
    assert tuple(planar_poses(found.poses)[0, :2]) == (4.5, 4.5)


def test_pose_after_the_jump_that_arrives_before_odometry_counts() -> None:
    planner = driven_away()
    planner.run_for(2.0)
    planner.publish("localization", pose_at((5.0, 5.0, 0.0), BEGIN + 2.0))

    planner.publish("odom", odom_at((0.0, 0.0, 0.0), BEGIN + 1.98))
    planner.publish("nav_command", follow(THERE, command_id=2))

    (plan,) = planner.take("plan")
    assert tuple(planar_poses(plan.poses)[0, :2]) == (5.0, 5.0)


def test_pose_from_before_a_time_reset_is_not_used() -> None:
    planner = driven_away()

    planner.publish("odom", odom_at((3.0, 2.3, 0.0), BEGIN - 50.0))
    planner.publish("nav_command", follow(THERE, command_id=2))
    planner.publish("localization", pose_at((4.5, 4.5, 0.0), BEGIN - 50.0))

    refused, found = planner.take("plan")
    assert refused.outcome == Plan.NOT_READY
    assert tuple(planar_poses(found.poses)[0, :2]) == (4.5, 4.5)


@pytest.mark.parametrize(
    ("seconds", "step"), [(0.05, (0.15, 0.0, 0.3)), (1.0, (1.0, 0.0, 2.0))], ids=["fast", "seldom"]
)
def test_fast_robots_and_rare_odometry_do_not_count_as_a_jump(seconds: float, step: Pose) -> None:
    planner = driven_away()

    planner.run_for(seconds)
    planner.publish("odom", odom_at(compose((3.0, 2.3, 0.0), step), planner.now))
    planner.publish("nav_command", follow(THERE, command_id=2))

    (plan,) = planner.take("plan")
    assert planar_poses(plan.poses)[0, :2] == pytest.approx((4.0 + step[0], 4.0))


def test_restarted_planner_continues_with_the_latched_goal() -> None:
    planner = start_planner(room())
    planner.publish("nav_command", follow(THERE, command_id=4))
    planner.take("plan")

    for step in ("deactivate", "cleanup", "configure", "activate"):
        planner.request(step)
    planner.run_for(0.5)
    planner.publish("localization", pose_at((2.0, 2.0, 0.0), planner.now))

    *refused, found = planner.take("plan")
    assert {(plan.command_id, plan.outcome) for plan in refused} == {(4, Plan.NOT_READY)}
    assert (found.command_id, found.outcome) == (4, Plan.FOUND)
    assert tuple(planar_poses(found.poses)[0, :2]) == (2.0, 2.0)


def test_map_update_outside_the_map_is_logged_and_ignored(caplog: pytest.LogCaptureFixture) -> None:
    planner = start_planner(room())

    planner.publish("map_updates", map_update((8.0, 0.0, 10.0, 1.0), 100))

    assert_words(caplog.text, "outside the map", "40 x 20", "column 160, row 0")


def test_cost_parameters_change_at_run_time() -> None:
    planner = start_planner(room(wall_with_door(0.6)))
    planner.publish("nav_command", follow(THERE))
    assert planner.take("plan")[0].outcome == Plan.FOUND

    planner.set_parameters({"radius": 0.4})
    planner.run_for(1.0)
    planner.publish("localization", pose_at(HERE, planner.now))

    assert [plan.outcome for plan in planner.take("plan")] == [Plan.UNREACHABLE]
