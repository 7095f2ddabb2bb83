"""The examiner believes the truth, not the robot."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from tests.cairn.tools.evaluation.examination import Examination

Begin = Callable[..., Examination]


@pytest.fixture
def begin(stage: Callable[..., Any], tmp_path: Path) -> Begin:
    return partial(Examination, stage, tmp_path)


def test_a_goal_is_reached_by_who_says_so_and_is_truly_there(begin: Begin) -> None:
    examination = begin(goals=1)
    goal = examination.arrive(off=(0.1, 0.1, 0.14))

    (result,) = examination.result.goals
    assert (result.reached, result.claimed) == (True, True)
    assert (result.x, result.y, result.theta) == pytest.approx(goal)
    assert result.end_error == pytest.approx(math.hypot(0.1, 0.1))
    assert result.end_turn == pytest.approx(0.14)
    assert result.reason == "as the robot says"


@pytest.mark.parametrize(
    ("off", "told"),
    [
        ((0.16, 0.0, 0.0), "said to be there, but was 0.16 m off and turned by 0.00 rad"),
        ((0.0, 0.0, 0.16), "said to be there, but was 0.00 m off and turned by 0.16 rad"),
        ((0.0, 0.0, math.pi), "said to be there, but was 0.00 m off and turned by 3.14 rad"),
    ],
)
def test_who_says_to_be_there_but_is_not_has_not_reached_the_goal(
    begin: Begin, off: Pose, told: str
) -> None:
    examination = begin(goals=1)
    examination.arrive(off)

    (result,) = examination.result.goals
    assert (result.reached, result.claimed, result.reason) == (False, True, told)


def test_what_counts_is_where_the_robot_claims_to_be_and_a_stated_allowance(begin: Begin) -> None:
    examination = begin(goals=1, position_tolerance=0.3, position_allowance=0.1)
    examination.arrive(off=(0.39, 0.0, 0.0))

    assert examination.result.goals[0].reached


def test_who_is_there_but_says_to_have_failed_has_not_reached_the_goal(begin: Begin) -> None:
    examination = begin(goals=1)
    examination.drive(examination.goal())
    examination.say(NavigationStatus.FAILED, recoveries=2)
    examination.stand(0.2)

    (result,) = examination.result.goals
    assert (result.reached, result.claimed, result.recoveries) == (False, False, 2)


def test_an_end_is_judged_by_the_truth_of_that_time_not_of_before(begin: Begin) -> None:
    examination = begin(goals=1)
    goal = examination.goal()
    examination.drive(goal)
    examination.robot = (goal[0] + 0.3, goal[1], goal[2])  # it slides on
    examination.stage.wait(0.05)
    examination.say(NavigationStatus.SUCCEEDED)
    there, examination.robot = examination.robot, goal
    examination.truth(ago_s=0.04)  # late: from before it slid
    examination.robot = there
    examination.stand(0.1)

    assert not examination.result.goals[0].reached


def test_collisions_are_written_down(begin: Begin) -> None:
    examination = begin(goals=1)
    examination.touch("table")
    examination.arrive()
    examination.touch("chair")

    assert examination.result.collisions == [
        "table at (1.00, 2.00), 0.30 m/s",
        "chair at (1.00, 2.00), 0.30 m/s",
    ]


def test_the_way_driven_is_the_true_one_and_the_shortest_that_of_the_world(begin: Begin) -> None:
    examination = begin(goals=2)
    start, goal = examination.robot, examination.goal()
    beside = (start[0], start[1] + 2.0, 0.0)
    examination.drive(beside, goal)
    examination.say(NavigationStatus.SUCCEEDED)
    examination.stand(0.2)
    examination.arrive()

    first, second = examination.result.goals
    assert first.shortest == pytest.approx(math.dist(start[:2], goal[:2]))
    assert first.driven == pytest.approx(2.0 + math.dist(beside[:2], goal[:2]))
    assert second.driven == pytest.approx(second.shortest)


def test_goals_and_ways_are_of_the_world_as_it_stands_then(begin: Begin) -> None:
    examination = begin(goals=2)
    examination.goal()
    examination.show((0.0, 3.0, 12.0, 10.0))  # all but a strip is blocked
    examination.say(NavigationStatus.FAILED)
    examination.stand(0.2)
    goal = examination.goal()

    assert 0.37 <= goal[1] <= 3.0 - 0.37


def test_goals_keep_the_radius_of_the_robot_and_more_from_what_stands(begin: Begin) -> None:
    examination = begin(goals=20, radius=0.8, clearance=0.5)

    for _ in range(20):
        x, y, _ = examination.arrive()
        assert min(x, 12.0 - x, y, 10.0 - y) >= 1.3


def test_goals_are_where_a_robot_of_that_radius_can_get_to(begin: Begin) -> None:
    examination = begin(goals=20, radius=0.4)
    examination.show((5.0, 0.0, 6.0, 4.0), (5.0, 4.6, 6.0, 10.0))  # it does not fit through

    for _ in range(20):
        x, _, _ = examination.arrive()
        assert x < 5.0


def test_who_takes_too_long_has_failed_and_its_late_result_is_not_that_of_the_next_goal(
    begin: Begin,
) -> None:
    examination = begin(goals=2, limit=20.0)
    examination.goal()
    examination.say(NavigationStatus.RECOVERING, recoveries=3)
    examination.stand(20.2)
    goal = examination.goal()
    examination.say(NavigationStatus.SUCCEEDED, order=1)  # of the goal before
    examination.stand(0.5)
    examination.drive(goal)
    examination.say(NavigationStatus.SUCCEEDED)
    examination.stand(0.2)

    late, next_ = examination.result.goals
    assert (late.reached, late.reason, late.recoveries) == (False, "not there after 20 s", 3)
    assert (next_.reached, next_.recoveries) == (True, 0)
    assert next_.seconds > math.dist((2.0, 2.0), goal[:2]) / 0.4


def test_a_robot_is_carried_off_when_the_truth_shows_it(begin: Begin) -> None:
    examination = begin(goals=1, kidnap_at=1, kidnap_after=1.0)
    goal, before = examination.goal(), examination.robot
    examination.stand(1.0)
    (place,) = examination.carried_to()
    examination.robot = place
    examination.stand(0.1)
    examination.told(before, ago_s=0.12)  # of a scan from before that, which comes late
    for _ in range(20):  # it does not notice
        examination.stand(0.1)
        examination.told(before)
    examination.told((*place[:2], place[2] + 2.0))  # there by chance, but turned
    examination.stand(0.5)
    examination.told(place)
    examination.told((place[0] + 0.2, *place[1:]))  # from now on errors count again
    examination.drive(goal)
    examination.say(NavigationStatus.SUCCEEDED)
    examination.stand(0.2)

    run = examination.result
    (result,) = run.goals
    assert (run.failure, result.reached, result.kidnapped) == ("", True, True)
    assert result.relocalized_s == pytest.approx(2.5)
    assert run.error_counts == {0: 1, 2000: 1}  # of who is lost they say little
    assert result.driven == pytest.approx(math.dist(place[:2], goal[:2]))
    assert math.dist(place[:2], before[:2]) >= 1.5


def test_who_was_there_before_it_was_carried_off_has_reached_its_goal(begin: Begin) -> None:
    examination = begin(goals=2, kidnap_at=1, kidnap_after=1.0)
    examination.drive(examination.goal())
    place = examination.carried_to()[-1]
    examination.say(NavigationStatus.SUCCEEDED)
    examination.robot = place
    examination.stand(0.1)
    goal = examination.goal()
    examination.stand(1.0)
    (examination.robot,) = examination.carried_to()  # the other one did not disturb anything
    examination.drive(goal)
    examination.say(NavigationStatus.SUCCEEDED)
    examination.stand(0.2)

    run = examination.result
    assert [(one.reached, one.kidnapped) for one in run.goals] == [(True, False), (True, True)]
    assert run.failure == ""


def test_a_robot_that_never_finds_itself_is_told_of_so(begin: Begin) -> None:
    examination = begin(goals=2, kidnap_at=1, kidnap_after=1.0)
    examination.goal()
    before = examination.robot
    examination.stand(1.0)
    (examination.robot,) = examination.carried_to()
    examination.stand(1.0)
    examination.told(before)
    examination.say(NavigationStatus.FAILED)
    examination.stand(0.2)
    examination.told(before)  # from the end of that goal on errors count, lost or not
    examination.arrive()

    run = examination.result
    assert [goal.kidnapped for goal in run.goals] == [True, False]
    assert run.goals[0].relocalized_s is None
    assert run.error_max is not None
    assert run.error_max > 1.0


def test_where_the_world_refuses_another_place_is_tried(begin: Begin) -> None:
    examination = begin(goals=1, kidnap_at=1, kidnap_after=1.0)
    goal = examination.goal()
    examination.stand(3.0)
    first, second, *_ = examination.carried_to()
    examination.told(examination.robot)
    assert math.dist(first[:2], second[:2]) > 0.0
    examination.robot = second
    examination.stand(0.1)
    examination.told(second)
    examination.drive(goal)
    assert examination.carried_to() == []  # once is enough
    examination.say(NavigationStatus.SUCCEEDED)
    examination.stand(0.2)

    (result,) = examination.result.goals
    assert result.kidnapped
    assert result.relocalized_s == pytest.approx(0.0)


def test_nobody_is_near_where_the_robot_is_set_down(begin: Begin) -> None:
    people = [(3.0, 8.0), (6.0, 2.5), (6.0, 7.5), (9.0, 5.0)]
    examination = begin(goals=1, kidnap_at=1, kidnap_after=1.0)
    examination.goal()
    examination.people(*people)
    examination.stand(12.0)

    places = examination.carried_to()

    assert len(places) >= 8
    assert min(math.dist(place[:2], one) for place in places for one in people) >= 1.5


def test_a_run_in_which_the_robot_was_never_carried_off_has_failed(begin: Begin) -> None:
    examination = begin(goals=2, kidnap_at=1, kidnap_after=1.0)
    for _ in range(2):
        goal = examination.goal()
        examination.stand(1.5)
        assert examination.carried_to()
        examination.drive(goal)
        examination.told(examination.robot)
        examination.say(NavigationStatus.SUCCEEDED)
        examination.stand(0.2)

    run = examination.result
    assert run.failure == "the robot was to be carried off and never was"
    assert [(goal.kidnapped, goal.relocalized_s) for goal in run.goals] == [(False, None)] * 2


def test_poses_are_compared_with_the_truth_of_their_time(begin: Begin) -> None:
    examination = begin(goals=1)
    goal = examination.goal()
    examination.drive((4.0, 2.0, 0.0))
    examination.told((3.6, 2.0, 0.0), ago_s=1.0)  # comes late: 0.4 m in a second
    examination.told((3.62, 2.0, 0.0), ago_s=0.95)
    examination.stage.wait(0.06)
    examination.told((4.0 + 0.06 * 0.4, 2.0, 0.0))  # newer than the last truth
    examination.robot = (4.04, 2.0, 0.0)
    examination.stage.wait(0.04)
    examination.truth()
    examination.told((4.04, 2.3, 0.0))
    examination.drive(goal)
    examination.say(NavigationStatus.SUCCEEDED)
    examination.stand(0.2)

    run = examination.result
    assert run.error_counts == {0: 3, 3000: 1}
    assert run.within == (0.75, 0.75, 0.75)
