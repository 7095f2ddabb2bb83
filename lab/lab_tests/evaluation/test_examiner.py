"""The examiner judges goals by the ground truth, not by what the robot reports."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from lab_tests.evaluation.examiner_harness import Examination
from tests.wording import assert_words

StartExamination = Callable[..., Examination]


@pytest.fixture
def start_examination(tmp_path: Path) -> StartExamination:
    return partial(Examination, tmp_path)


def test_goal_is_reached_if_the_robot_reports_it_and_the_truth_agrees(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=1)
    goal = examination.arrive(offset=(0.1, 0.1, 0.14))

    (result,) = examination.result.goals
    assert (result.reached, result.claimed) == (True, True)
    assert (result.x, result.y, result.theta) == pytest.approx(goal)
    assert result.end_error == pytest.approx(math.hypot(0.1, 0.1))
    assert result.end_turn == pytest.approx(0.14)
    assert result.reason == "reported by the robot"


@pytest.mark.parametrize(
    ("offset", "error"),
    [
        ((0.16, 0.0, 0.0), "0.16 m and 0.00 rad from the goal"),
        ((0.0, 0.0, 0.16), "0.00 m and 0.16 rad from the goal"),
        ((0.0, 0.0, math.pi), "0.00 m and 3.14 rad from the goal"),
    ],
)
def test_goal_is_not_reached_if_the_truth_contradicts_the_reported_success(
    start_examination: StartExamination, offset: Pose, error: str
) -> None:
    examination = start_examination(goals=1)
    examination.arrive(offset)

    (result,) = examination.result.goals
    assert (result.reached, result.claimed) == (False, True)
    assert result.reason.endswith(error)


def test_tolerance_is_that_of_the_robot_plus_an_allowance(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=1, position_tolerance=0.3, position_allowance=0.1)
    examination.arrive(offset=(0.39, 0.0, 0.0))

    assert examination.result.goals[0].reached


def test_goal_is_not_reached_if_the_robot_reports_failure_at_the_goal(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=1)
    examination.drive(examination.accept_goal())
    examination.publish_status(NavigationStatus.FAILED, recoveries=2)
    examination.stand(0.2)

    (result,) = examination.result.goals
    assert (result.reached, result.claimed, result.recoveries) == (False, False, 2)


def test_end_is_compared_with_the_truth_at_its_time(start_examination: StartExamination) -> None:
    examination = start_examination(goals=1)
    goal = examination.accept_goal()
    examination.drive(goal)
    examination.robot = (goal[0] + 0.3, goal[1], goal[2])  # it slides
    examination.examiner.run_for(0.05)
    examination.publish_status(NavigationStatus.SUCCEEDED)
    there, examination.robot = examination.robot, goal
    examination.publish_truth(ago_s=0.04)  # late: from before it slid
    examination.robot = there
    examination.stand(0.1)

    assert not examination.result.goals[0].reached


def test_collisions_are_recorded(start_examination: StartExamination) -> None:
    examination = start_examination(goals=1)
    examination.publish_collision("table")
    examination.arrive()
    examination.publish_collision("chair")

    assert examination.result.collisions == [
        "table at (1.00, 2.00), 0.30 m/s",
        "chair at (1.00, 2.00), 0.30 m/s",
    ]


def test_driven_length_is_that_of_the_true_path_and_shortest_that_of_the_world(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=2)
    start, goal = examination.robot, examination.accept_goal()
    beside = (start[0], start[1] + 2.0, 0.0)
    examination.drive(beside, goal)
    examination.succeed()
    examination.arrive()

    first, second = examination.result.goals
    assert first.shortest == pytest.approx(math.dist(start[:2], goal[:2]))
    assert first.driven == pytest.approx(2.0 + math.dist(beside[:2], goal[:2]))
    assert second.driven == pytest.approx(second.shortest)


def test_goals_follow_changes_of_the_world(start_examination: StartExamination) -> None:
    examination = start_examination(goals=2)
    examination.accept_goal()
    examination.publish_scene((0.0, 3.0, 12.0, 10.0))  # only a strip is free
    examination.publish_status(NavigationStatus.FAILED)
    examination.stand(0.2)
    goal = examination.accept_goal()

    assert 0.37 <= goal[1] <= 3.0 - 0.37


def test_goals_keep_clearance_from_obstacles(start_examination: StartExamination) -> None:
    examination = start_examination(goals=20, radius=0.8, clearance=0.5)

    for _ in range(20):
        x, y, _ = examination.arrive()
        assert min(x, 12.0 - x, y, 10.0 - y) >= 1.3


def test_goals_are_reachable_for_the_robot_radius(start_examination: StartExamination) -> None:
    examination = start_examination(goals=20, radius=0.4)
    examination.publish_scene(
        (5.0, 0.0, 6.0, 4.0), (5.0, 4.6, 6.0, 10.0)
    )  # too narrow for the robot

    for _ in range(20):
        x, _, _ = examination.arrive()
        assert x < 5.0


def test_goal_times_out_and_its_late_result_does_not_count_for_the_next(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=2, limit=40.0)  # [s]: enough for the diagonal
    examination.accept_goal()
    examination.publish_status(NavigationStatus.RECOVERING, recoveries=3)
    examination.stand(40.2)
    goal = examination.accept_goal()
    examination.publish_status(NavigationStatus.SUCCEEDED, mission=1)  # of the previous goal
    examination.stand(0.5)
    examination.drive(goal)
    examination.succeed()

    late, next_ = examination.result.goals
    assert (late.reached, late.reason, late.recoveries) == (False, "not reached within 40 s", 3)
    assert (next_.reached, next_.recoveries) == (True, 0)
    assert next_.seconds > math.dist((2.0, 2.0), goal[:2]) / 0.4


def test_kidnapping_counts_from_when_the_truth_shows_it(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=1, kidnap_at=1, kidnap_after=1.0)
    goal, before = examination.accept_goal(), examination.robot
    examination.stand(1.0)
    (place,) = examination.kidnap_targets()
    examination.robot = place
    examination.stand(0.1)
    examination.publish_estimate(before, ago_s=0.12)  # late: from a scan before the kidnapping
    for _ in range(20):  # the robot does not notice
        examination.stand(0.1)
        examination.publish_estimate(before)
    examination.publish_estimate((*place[:2], place[2] + 2.0))  # by chance
    examination.stand(0.5)
    examination.publish_estimate(place)
    examination.publish_estimate((place[0] + 0.2, *place[1:]))  # errors count again
    examination.drive(goal)
    examination.succeed()

    run = examination.result
    (result,) = run.goals
    assert (run.failure, result.reached, result.kidnapped) == ("", True, True)
    assert result.relocalized_s == pytest.approx(2.5)
    assert run.error_counts == {0: 1, 2000: 1}  # errors of a lost robot do not count
    assert result.driven == pytest.approx(math.dist(place[:2], goal[:2]))
    assert math.dist(place[:2], before[:2]) >= 1.5


def test_goal_reached_before_the_kidnapping_counts(start_examination: StartExamination) -> None:
    examination = start_examination(goals=2, kidnap_at=1, kidnap_after=1.0)
    examination.drive(examination.accept_goal())
    place = examination.kidnap_targets()[-1]
    examination.publish_status(NavigationStatus.SUCCEEDED)
    examination.robot = place
    examination.stand(0.1)
    goal = examination.accept_goal()
    examination.stand(1.0)
    (examination.robot,) = examination.kidnap_targets()
    examination.drive(goal)
    examination.succeed()

    run = examination.result
    assert [(one.reached, one.kidnapped) for one in run.goals] == [(True, False), (True, True)]
    assert run.failure == ""


def test_robot_that_never_relocalizes_has_no_relocalization_time(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=2, kidnap_at=1, kidnap_after=1.0)
    examination.accept_goal()
    before = examination.robot
    examination.stand(1.0)
    (examination.robot,) = examination.kidnap_targets()
    examination.stand(1.0)
    examination.publish_estimate(before)
    examination.publish_status(NavigationStatus.FAILED)
    examination.stand(0.2)
    examination.publish_estimate(before)  # errors count again from the end of that goal
    examination.arrive()

    run = examination.result
    assert [goal.kidnapped for goal in run.goals] == [True, False]
    assert run.goals[0].relocalized_s is None
    assert run.error_max is not None
    assert run.error_max > 1.0


def test_rejected_kidnapping_is_retried_elsewhere(start_examination: StartExamination) -> None:
    examination = start_examination(goals=1, kidnap_at=1, kidnap_after=1.0)
    goal = examination.accept_goal()
    examination.stand(3.0)
    first, second, *_ = examination.kidnap_targets()
    examination.publish_estimate(examination.robot)
    assert math.dist(first[:2], second[:2]) > 0.0
    examination.robot = second
    examination.stand(0.1)
    examination.publish_estimate(second)
    examination.drive(goal)
    assert examination.kidnap_targets() == []  # not asked again
    examination.succeed()

    (result,) = examination.result.goals
    assert result.kidnapped
    assert result.relocalized_s == pytest.approx(0.0)


def test_kidnapping_avoids_people(start_examination: StartExamination) -> None:
    people = [(3.0, 8.0), (6.0, 2.5), (6.0, 7.5), (9.0, 5.0)]
    examination = start_examination(goals=1, kidnap_at=1, kidnap_after=1.0)
    examination.accept_goal()
    examination.publish_people(*people)
    examination.stand(12.0)

    places = examination.kidnap_targets()

    assert len(places) >= 8
    assert min(math.dist(place[:2], one) for place in places for one in people) >= 1.5


def test_run_without_the_requested_kidnapping_is_invalid(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=2, kidnap_at=1, kidnap_after=1.0)
    for _ in range(2):
        goal = examination.accept_goal()
        examination.stand(1.5)
        assert examination.kidnap_targets()
        examination.drive(goal)
        examination.publish_estimate(examination.robot)
        examination.succeed()

    run = examination.result
    assert_words(run.failure, "never kidnapped")
    assert [(goal.kidnapped, goal.relocalized_s) for goal in run.goals] == [(False, None)] * 2


def test_estimates_are_compared_with_the_truth_of_their_time(
    start_examination: StartExamination,
) -> None:
    examination = start_examination(goals=1)
    goal = examination.accept_goal()
    examination.drive((4.0, 2.0, 0.0))
    examination.publish_estimate((3.6, 2.0, 0.0), ago_s=1.0)  # late: 0.4 m in a second
    examination.publish_estimate((3.62, 2.0, 0.0), ago_s=0.95)
    examination.examiner.run_for(0.06)
    examination.publish_estimate((4.0 + 0.06 * 0.4, 2.0, 0.0))  # newer than the last truth
    examination.robot = (4.04, 2.0, 0.0)
    examination.examiner.run_for(0.04)
    examination.publish_truth()
    examination.publish_estimate((4.04, 2.3, 0.0))
    examination.drive(goal)
    examination.succeed()

    run = examination.result
    assert run.error_counts == {0: 3, 3000: 1}
    assert run.within == (0.75, 0.75, 0.75)
