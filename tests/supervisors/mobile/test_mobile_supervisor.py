"""The mobile supervisor: takes orders, keeps them until their result, and through its own end."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cairn import LATCHED, CairnError
from cairn.deployment.load import load_deployment
from cairn.planar.messages import planar_poses, pose_message
from cairn.schemas.cairn_nav_msgs import NavigateGoal, NavigationStatus
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.std_msgs import Header
from cairn.supervisors.mobile.mission import load_mission, parse_goals
from tests.navigation.deployed import Deployed, taken

TREE = """
cairn: 1
robot: robot
components:
  mobile_supervisor:
    plugin: mobile_supervisor
    restart: transient
    significant: true
    parameters: {state_file: "${here}/mission.json"}
    children:
      automove: {plugin: test_beacon, load: on_request}
"""
MISSION = (
    "components.mobile_supervisor.parameters.mission=[[1, 2, 0]]",
    "components.mobile_supervisor.parameters.finish=true",
)
DeployedOf = Callable[..., Deployed]


@pytest.fixture
def deployed(tmp_path: Path) -> Iterator[DeployedOf]:
    made: list[Deployed] = []

    def make(*sets: str, text: str = TREE) -> Deployed:
        file = tmp_path / "deployment.yaml"
        file.write_text(text, encoding="utf-8")
        made.append(Deployed(load_deployment(file, sets=sets)))
        return made[-1]

    yield make
    for one in made:
        one.end()


def goals_of(order: NavigateGoal) -> list[list[float]]:
    rows: list[list[float]] = planar_poses(order.goals).round(6).tolist()
    return rows


def publish_status(robot: Deployed, **status: Any) -> None:
    robot.publish("navigation_status", NavigationStatus(**status), LATCHED)


def test_mission_is_published_latched_and_kept_until_its_result(
    deployed: DeployedOf, tmp_path: Path
) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    goals = [[1.0, -2.0, 0.5], [3.0, 4.0, 0.0]]
    number = robot.ask("mobile_supervisor", "go", goals=goals)["mission_id"]
    (first,) = taken(orders)
    assert (first.mission_id, first.first, goals_of(first)) == (number, 0, goals)

    publish_status(robot, mission_id=number, state=NavigationStatus.DRIVING, goal=1, goals=2)
    (again,) = taken(orders)
    assert (again.mission_id, again.first, goals_of(again)) == (number, 1, goals)
    kept = load_mission(tmp_path / "mission.json")
    assert kept is not None
    assert (kept.mission_id, kept.first, kept.result) == (number, 1, "")

    publish_status(
        robot,
        mission_id=number,
        state=NavigationStatus.SUCCEEDED,
        goal=2,
        goals=2,
        reason="arrived",
    )
    (over,) = taken(orders)
    assert (over.mission_id, len(over.goals)) == (number, 0)
    assert robot.ask("mobile_supervisor", "mission")["result"] == "succeeded: arrived"


def test_mission_ids_increase_and_old_statuses_are_ignored(
    deployed: DeployedOf,
) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    one = robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])["mission_id"]
    two = robot.ask("mobile_supervisor", "go", goals=[[3.0, 2.0, 0.0]])["mission_id"]
    assert two > one
    taken(orders)
    publish_status(robot, mission_id=one, state=NavigationStatus.FAILED)
    assert taken(orders) == []
    assert robot.ask("mobile_supervisor", "mission")["result"] == ""


def test_mission_is_canceled_once(deployed: DeployedOf) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    with pytest.raises(CairnError, match="there is no mission to cancel"):
        robot.ask("mobile_supervisor", "cancel")
    number = robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])["mission_id"]
    with pytest.raises(CairnError, match="there is no mission 3 under way"):
        robot.ask("mobile_supervisor", "cancel", mission_id=3)
    assert robot.ask("mobile_supervisor", "cancel", mission_id=number) == {"mission_id": number}
    assert [len(order.goals) for order in taken(orders)] == [1, 0]
    with pytest.raises(CairnError, match="there is no mission to cancel"):
        robot.ask("mobile_supervisor", "cancel")


def test_mission_is_canceled_by_its_token(deployed: DeployedOf) -> None:
    robot = deployed()
    goals = [[1.0, 2.0, 0.0]]
    number = robot.ask("mobile_supervisor", "go", goals=goals, token="mine")["mission_id"]
    for other in ("yours", ""):
        with pytest.raises(CairnError, match="the mission under way is of another client"):
            robot.ask("mobile_supervisor", "cancel", token=other)
    assert robot.ask("mobile_supervisor", "cancel", token="mine") == {"mission_id": number}

    robot.ask("mobile_supervisor", "go", goals=goals)  # without a token
    with pytest.raises(CairnError, match="is of another client"):
        robot.ask("mobile_supervisor", "cancel", token="mine")


@pytest.mark.parametrize("token", ["", 7, "x" * 65])
def test_invalid_token_is_rejected(deployed: DeployedOf, token: Any) -> None:
    with pytest.raises(CairnError, match=r"token = .*: give 1 to 64 characters"):
        deployed().ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]], token=token)


def test_goal_pose_starts_a_mission_unless_its_frame_is_wrong(deployed: DeployedOf) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    for frame in ("map", "", "odom"):
        pose = pose_message((-1.0, 2.0, 0.5))
        robot.publish("goal_pose", PoseStamped(header=Header(frame_id=frame), pose=pose))
    assert [goals_of(order) for order in taken(orders)] == [[[-1.0, 2.0, 0.5]]] * 2


def test_restarted_supervisor_continues_the_mission(deployed: DeployedOf) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    goals = [[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]]
    number = robot.ask("mobile_supervisor", "go", goals=goals)["mission_id"]
    publish_status(robot, mission_id=number, state=NavigationStatus.DRIVING, goal=1, goals=2)
    taken(orders)

    robot.ask("root", "restart", name="mobile_supervisor")

    (again,) = taken(orders)
    assert (again.mission_id, again.first, goals_of(again)) == (number, 1, goals)


def test_finished_mission_stays_finished_after_a_restart(
    deployed: DeployedOf,
) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    number = robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])["mission_id"]
    publish_status(robot, mission_id=number, state=NavigationStatus.FAILED, reason="no path")
    taken(orders)

    robot.ask("root", "restart", name="mobile_supervisor")

    assert taken(orders) == []
    assert robot.ask("mobile_supervisor", "mission")["result"] == "failed: no path"
    assert robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])["mission_id"] > number


def test_mission_is_given_up_after_several_restarts(deployed: DeployedOf) -> None:
    robot = deployed()
    robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])
    for _ in range(4):
        robot.wait(20.0)
        robot.ask("root", "restart", name="mobile_supervisor")
    assert robot.ask("mobile_supervisor", "mission")["result"] == (
        "failed: given up after 3 restarts of mobile_supervisor"
    )


@pytest.mark.parametrize("text", ["", "{}", '{"mission_id": 1, "goals": [[NaN, 0, 0]]}', "\x00"])
def test_unreadable_mission_file_is_logged(deployed: DeployedOf, tmp_path: Path, text: str) -> None:
    robot = deployed()
    orders = robot.read("navigate_goal", NavigateGoal)
    robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])
    taken(orders)
    (tmp_path / "mission.json").write_text(text, encoding="utf-8")

    robot.ask("root", "restart", name="mobile_supervisor")

    assert taken(orders) == []
    assert robot.ask("mobile_supervisor", "mission") is None


def test_mission_of_an_earlier_run_is_removed(deployed: DeployedOf, tmp_path: Path) -> None:
    first = deployed()
    first.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])
    first.end()
    second = deployed()
    orders = second.read("navigate_goal", NavigateGoal)

    second.ask("root", "restart", name="mobile_supervisor")

    assert taken(orders) == []
    assert not (tmp_path / "mission.json").exists()


def test_configured_mission_starts_at_once_and_ends_the_deployment(deployed: DeployedOf) -> None:
    robot = deployed(*MISSION)
    orders = robot.read("navigate_goal", NavigateGoal)
    robot.wait(0.0)
    (order,) = taken(orders)

    publish_status(
        robot, mission_id=order.mission_id, state=NavigationStatus.FAILED, reason="no path"
    )

    robot.await_that(lambda: robot.run.end is not None)
    assert robot.run.end is not None
    assert robot.run.end.reason == ("mobile_supervisor has finished: the mission failed: no path")


def test_restarted_supervisor_knows_that_the_mission_was_preempted(
    deployed: DeployedOf,
) -> None:
    robot = deployed(*MISSION)
    robot.ask("mobile_supervisor", "go", goals=[[3.0, 4.0, 0.0]])
    number = robot.ask("mobile_supervisor", "go", goals=[[5.0, 6.0, 0.0]])["mission_id"]

    robot.ask("root", "restart", name="mobile_supervisor")
    publish_status(robot, mission_id=number, state=NavigationStatus.SUCCEEDED, reason="arrived")

    robot.await_that(lambda: robot.run.end is not None)
    assert robot.run.end is not None
    assert robot.run.end.reason == (
        f"mobile_supervisor has finished: the mission was preempted by mission {number}, which "
        "succeeded: arrived"
    )


def test_mission_without_automove_is_rejected(deployed: DeployedOf) -> None:
    robot = deployed("components.mobile_supervisor.parameters.automove=driver")
    with pytest.raises(CairnError, match="mobile_supervisor has no child driver"):
        robot.ask("mobile_supervisor", "go", goals=[[1.0, 2.0, 0.0]])


def test_missing_state_folder_is_reported_at_once(deployed: DeployedOf) -> None:
    robot = deployed("components.mobile_supervisor.parameters.state_file=/nowhere/mission.json")
    with pytest.raises(CairnError, match="/nowhere: no such folder to keep the mission in"):
        robot.begin()


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ([], "at least one goal"),
        (None, "at least one goal"),
        ([[1.0, 2.0]], r"goal 1 = \[1.0, 2.0\]: give x \[m\], y \[m\] and heading"),
        ([[0, 0, 0], [1.0, math.nan, 0.0]], "goal 2 = .*must be finite"),
        ([[1.0, -2e5, 0.0]], "at most 100000"),
        ([[True, 0, 0]], "goal 1"),
        (["0,0,0"], "goal 1"),
    ],
)
def test_invalid_goal_is_rejected_with_its_number(given: Any, why: str) -> None:
    with pytest.raises(CairnError, match=why):
        parse_goals(given)
