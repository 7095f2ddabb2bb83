"""The mobile supervisor: accepts missions and keeps them until they end, also across restarts."""

import errno
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from cairn import LATCHED, CairnError
from cairn.bus.actions import STATUS_TEXT, SentGoal, uuid_of
from cairn.client.connection import Connection
from cairn.client.navigation import MissionClient
from cairn.planar.messages import packed_poses, planar_poses, pose_message
from cairn.schemas.action_msgs.msg import GoalInfo, GoalStatus
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.cairn_nav_msgs import (
    MAX_GOALS,
    MissionOutcome,
    NavigateGoal,
    NavigationStatus,
    ReasonCode,
)
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.message import InvalidMessage
from cairn.schemas.nav2_msgs.action import NavigateThroughPoses
from cairn.schemas.std_msgs import Header
from cairn.supervisors.mobile import mission_file
from cairn.supervisors.mobile.mission_file import (
    ActionRecord,
    Mission,
    MissionFile,
    MissionResult,
    check_goals,
)
from cairn.system.files import replace_file
from cairn.testing.lockstep import DeploymentHarness
from tests.navigation.driving import send_poses
from tests.wording import assert_words, words_in_order

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
MakeHarness = Callable[..., DeploymentHarness]


@pytest.fixture
def make_harness(tmp_path: Path) -> Iterator[MakeHarness]:
    harnesses: list[DeploymentHarness] = []

    def make(*sets: str, text: str = TREE) -> DeploymentHarness:
        file = tmp_path / "deployment.yaml"
        file.write_text(text, encoding="utf-8")
        harnesses.append(DeploymentHarness(file, sets=sets))
        return harnesses[-1]

    yield make
    for one in harnesses:
        one.shutdown()


def goals_of(mission: NavigateGoal) -> list[list[float]]:
    rows: list[list[float]] = planar_poses(mission.goals).round(6).tolist()
    return rows


def go(robot: DeploymentHarness, *goals: Sequence[float]) -> tuple[int, SentGoal[Any, Any, Any]]:
    """Send goals; return the number of the mission, and the action's goal."""
    sent = send_poses(robot, *goals)
    missions = robot.read("navigate_goal", NavigateGoal, qos=LATCHED)
    robot.run_for(0.0)
    return missions.take()[-1].mission_id, sent


def outcome(sent: SentGoal[Any, Any, Any]) -> str:
    """Return how a goal has ended, and why."""
    assert sent.result is not None
    assert sent.status is not None
    return f"{STATUS_TEXT[sent.status]}: {sent.result.error_msg}"


def publish_status(robot: DeploymentHarness, **status: Any) -> None:
    robot.publish("navigation_status", NavigationStatus(**status), qos=LATCHED)


def test_mission_is_published_latched_and_kept_until_its_result(
    make_harness: MakeHarness, tmp_path: Path
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    goals = [[1.0, -2.0, 0.5], [3.0, 4.0, 0.0]]
    number, sent = go(robot, *goals)
    (first,) = missions.take()
    assert first.goal_id.uuid.tobytes() == sent.id
    assert (first.mission_id, first.first, goals_of(first)) == (number, 0, goals)

    publish_status(robot, mission_id=number, state=NavigationStatus.DRIVING, goal=1, goals=2)
    (again,) = missions.take()
    assert (again.mission_id, again.first, goals_of(again)) == (number, 1, goals)
    saved = MissionFile(tmp_path / "mission.json").load()
    assert saved is not None
    assert (saved.mission_id, saved.first, saved.result) == (number, 1, None)

    publish_status(
        robot,
        mission_id=number,
        state=NavigationStatus.SUCCEEDED,
        goal=2,
        goals=2,
        reason="arrived",
    )
    (over,) = missions.take()
    assert (over.mission_id, len(over.goals)) == (number, 0)
    assert outcome(sent) == "succeeded: "


def test_mission_ids_increase_and_old_statuses_are_ignored(
    make_harness: MakeHarness,
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    one, preempted = go(robot, [1.0, 2.0, 0.0])
    two, sent = go(robot, [3.0, 2.0, 0.0])
    assert two > one
    missions.take()
    publish_status(robot, mission_id=one, state=NavigationStatus.FAILED)
    assert missions.take() == []
    assert not sent.has_ended
    assert outcome(preempted) == f"aborted: preempted by mission {two}"


def exploration_goal(*goals: list[float]) -> NavigateGoal:
    return NavigateGoal(goals=packed_poses(np.array(goals).reshape(-1, 3)))


def test_goals_of_the_explorer_preempt_each_other_and_are_canceled(
    make_harness: MakeHarness, tmp_path: Path
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    robot.publish("exploration_goal", exploration_goal([1.0, 2.0, 0.0]))
    robot.publish("exploration_goal", exploration_goal([3.0, 2.0, 0.5]))
    first, second = missions.take()
    assert goals_of(second) == [[3.0, 2.0, 0.5]]
    assert second.mission_id > first.mission_id

    robot.publish("exploration_goal", exploration_goal())
    (canceled,) = missions.take()
    assert (canceled.mission_id, len(canceled.goals)) == (second.mission_id, 0)
    saved = MissionFile(tmp_path / "mission.json").load()
    assert saved is not None
    assert str(saved.result) == "canceled: the exploration has ended"


def test_explorer_neither_preempts_nor_cancels_a_mission_of_an_operator(
    make_harness: MakeHarness,
) -> None:
    robot = make_harness()
    robot.publish("exploration_goal", exploration_goal([1.0, 2.0, 0.0]))
    missions = robot.read("navigate_goal", NavigateGoal)
    missions.take()
    number, _ = go(robot, [5.0, 5.0, 0.0])
    assert len(missions.take()) == 1

    robot.publish("exploration_goal", exploration_goal([1.0, 2.0, 0.0]))
    robot.publish("exploration_goal", exploration_goal())
    assert missions.take() == []

    publish_status(robot, mission_id=number, state=NavigationStatus.SUCCEEDED)
    missions.take()
    robot.publish("exploration_goal", exploration_goal([1.0, 2.0, 0.0]))
    assert goals_of(missions.take()[-1]) == [[1.0, 2.0, 0.0]]


def cancel(robot: DeploymentHarness, action: str, identity: bytes = bytes(16)) -> int:
    """Cancel a goal, or all without an id; return how many are canceled."""
    wanted = GoalInfo(goal_id=uuid_of(identity))
    request = CancelGoal.Request(goal_info=wanted)
    return len(robot.call(f"{action}/_action/cancel_goal", CancelGoal, request).goals_canceling)


def test_mission_is_canceled_once(make_harness: MakeHarness) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    assert cancel(robot, "navigate_through_poses") == 0
    _, sent = go(robot, [1.0, 2.0, 0.0])
    assert cancel(robot, "navigate_through_poses", bytes(15) + b"x") == 0
    assert cancel(robot, "navigate_through_poses", sent.id) == 1
    assert [len(mission.goals) for mission in missions.take()] == [1, 0]
    assert outcome(sent) == "canceled: on request"
    assert cancel(robot, "navigate_through_poses", sent.id) == 0


def test_missions_that_no_client_sent_are_goals_too(make_harness: MakeHarness) -> None:
    robot = make_harness(*MISSION)
    missions = robot.read("navigate_goal", NavigateGoal)
    assert cancel(robot, "navigate_through_poses") == 1

    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    for _ in range(2):
        robot.publish("goal_pose", PoseStamped(pose=pose_message((1.0, 2.0, 0.0))))
    robot.publish("exploration_goal", exploration_goal([1.0, 2.0, 0.0]))  # refused
    assert cancel(robot, "navigate_to_pose") == 1
    robot.publish("exploration_goal", exploration_goal([1.0, 2.0, 0.0]))
    assert cancel(robot, "navigate_through_poses") == 1

    identities = {mission.goal_id.uuid.tobytes() for mission in missions.take()}
    assert len(identities) == 3


def test_goal_pose_starts_a_mission_unless_its_frame_is_wrong(make_harness: MakeHarness) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    for frame in ("map", "", "odom"):
        pose = pose_message((-1.0, 2.0, 0.5))
        robot.publish("goal_pose", PoseStamped(header=Header(frame_id=frame), pose=pose))
    assert [goals_of(mission) for mission in missions.take()] == [[[-1.0, 2.0, 0.5]]] * 2


def test_restarted_supervisor_continues_the_mission(make_harness: MakeHarness) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    goals = [[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]]
    number, sent = go(robot, *goals)
    publish_status(robot, mission_id=number, state=NavigationStatus.DRIVING, goal=1, goals=2)
    missions.take()

    robot.request("root", "restart", name="mobile_supervisor")

    (again,) = missions.take()
    assert (again.mission_id, again.first, goals_of(again)) == (number, 1, goals)
    assert again.goal_id.uuid.tobytes() == sent.id


def test_finished_mission_stays_finished_after_a_restart(
    make_harness: MakeHarness,
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    number, sent = go(robot, [1.0, 2.0, 0.0])
    publish_status(
        robot, mission_id=number, state=NavigationStatus.FAILED, reason="no path",
        reason_code=ReasonCode.NO_PLAN,
    )  # fmt: skip
    missions.take()

    robot.request("root", "restart", name="mobile_supervisor")

    assert missions.take() == []
    again = result_of(robot, sent)
    assert again.status == GoalStatus.STATUS_ABORTED
    assert (again.result.error_msg, again.result.error_code) == ("no path", 208)
    assert go(robot, [1.0, 2.0, 0.0])[0] > number


def result_of(robot: DeploymentHarness, sent: SentGoal[Any, Any, Any]) -> Any:
    """Return the answer to the request for a goal's result."""
    request = NavigateThroughPoses.GetResult.Request(goal_id=uuid_of(sent.id))
    service = "navigate_through_poses/_action/get_result"
    return robot.call(service, NavigateThroughPoses.GetResult, request)


def test_mission_is_given_up_after_several_restarts(make_harness: MakeHarness) -> None:
    robot = make_harness()
    _, sent = go(robot, [1.0, 2.0, 0.0])
    for _ in range(4):
        robot.run_for(20.0)
        robot.request("root", "restart", name="mobile_supervisor")
    again = result_of(robot, sent)
    assert again.status == GoalStatus.STATUS_ABORTED
    assert_words(again.result.error_msg, "3 restarts", "mobile_supervisor")


OF_AN_OLDER_VERSION = (
    '{"mission_id":1,"requested_ns":1,"goals":[[1,2,0]],"first":0,"result":"","configured":false,'
    '"replaces_configured":false,"resumed":0,"token":null}'
)
TOO_MANY = f'{{"mission_id":1,"requested_ns":1,"goals":{[[0, 0, 0]] * (MAX_GOALS + 1)}}}'


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("mission.json", ""),
        ("mission.json", "{}"),
        ("mission.json", '{"mission_id": 1, "goals": [[NaN, 0, 0]]}'),
        ("mission.json", "\x00"),
        ("mission.json", OF_AN_OLDER_VERSION),
        ("mission.json", TOO_MANY),
        ("mission.json.progress", ""),
        ("mission.json.progress", '{"mission_id": 9999999999, "first": 0}'),
        ("mission.json.progress", '{"mission_id": 1, "first": -1}'),
    ],
)
def test_unreadable_mission_is_logged_and_not_continued(
    make_harness: MakeHarness,
    tmp_path: Path,
    name: str,
    text: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    _, sent = go(robot, [1.0, 2.0, 0.0])
    missions.take()
    (tmp_path / name).write_text(text, encoding="utf-8")

    robot.request("root", "restart", name="mobile_supervisor")

    assert missions.take() == []
    assert result_of(robot, sent).status == GoalStatus.STATUS_UNKNOWN
    assert_words(caplog.text, "not continued", name, "send the goals again")


def test_mission_of_an_earlier_run_is_removed(make_harness: MakeHarness, tmp_path: Path) -> None:
    first = make_harness()
    go(first, [1.0, 2.0, 0.0])
    first.shutdown()
    second = make_harness()
    missions = second.read("navigate_goal", NavigateGoal)

    second.request("root", "restart", name="mobile_supervisor")

    assert missions.take() == []
    assert not list(tmp_path.glob("mission.json*"))


def test_configured_mission_starts_at_once_and_ends_the_deployment(
    make_harness: MakeHarness,
) -> None:
    robot = make_harness(*MISSION)
    missions = robot.read("navigate_goal", NavigateGoal)
    robot.run_for(0.0)
    (mission,) = missions.take()

    publish_status(
        robot, mission_id=mission.mission_id, state=NavigationStatus.FAILED, reason="no path"
    )

    robot.run_until(lambda: robot.end is not None)
    assert robot.end is not None
    assert_words(robot.end.reason, "mobile_supervisor", "mission failed", "no path")


def test_restarted_supervisor_knows_that_the_mission_was_preempted(
    make_harness: MakeHarness,
) -> None:
    robot = make_harness(*MISSION)
    go(robot, [3.0, 4.0, 0.0])
    number, _ = go(robot, [5.0, 6.0, 0.0])

    robot.request("root", "restart", name="mobile_supervisor")
    publish_status(robot, mission_id=number, state=NavigationStatus.SUCCEEDED, reason="arrived")

    robot.run_until(lambda: robot.end is not None)
    assert robot.end is not None
    assert_words(
        robot.end.reason,
        "mobile_supervisor",
        f"preempted by mission {number}",
        "succeeded: arrived",
    )


def test_mission_without_automove_is_aborted(make_harness: MakeHarness) -> None:
    robot = make_harness("components.mobile_supervisor.parameters.automove=driver")
    sent = send_poses(robot, [1.0, 2.0, 0.0])
    assert_words(outcome(sent), "aborted", "mobile_supervisor has no child driver")


def test_missing_state_folder_is_reported_at_once(make_harness: MakeHarness) -> None:
    robot = make_harness("components.mobile_supervisor.parameters.state_file=/nowhere/mission.json")
    with pytest.raises(CairnError, match=words_in_order("/nowhere", "no such folder")):
        robot.start()


@pytest.mark.parametrize(
    ("goals", "error"),
    [
        ([[0, 0, 0], [1.0, math.nan, 0.0]], "goal 2 = .*must be finite"),
        ([[1.0, -2e5, 0.0]], "at most 100000"),
        ([[0.0, 0.0, 0.0]] * (MAX_GOALS + 1), "1,001 goals: .* at most 1,000"),
    ],
)
def test_invalid_goal_is_rejected_with_its_number(goals: Any, error: str) -> None:
    with pytest.raises(CairnError, match=error):
        check_goals(goals)


GOALS = tuple((float(number), -0.5, 0.25) for number in range(MAX_GOALS))


def test_longest_mission_is_canceled_and_a_longer_one_aborted(
    make_harness: MakeHarness, tmp_path: Path
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    assert_words(outcome(send_poses(robot, *GOALS, GOALS[0])), "1,001 goals", "at most 1,000")
    _, sent = go(robot, *GOALS)
    assert cancel(robot, "navigate_through_poses", sent.id) == 1

    assert [len(mission.goals) for mission in missions.take()] == [MAX_GOALS, 0]
    assert (tmp_path / "mission.json.progress").stat().st_size < 200


def test_more_goals_than_allowed_are_refused_wherever_they_are_given(
    make_harness: MakeHarness,
) -> None:
    too_many = [*GOALS, (0.0, 0.0, 0.0)]
    with pytest.raises(InvalidMessage, match=words_in_order("goals = 1001", "at most 1000")):
        NavigateGoal(goals=packed_poses(np.array(too_many)))
    with pytest.raises(CairnError, match=words_in_order("1,001 goals", "at most 1,000")):
        MissionClient(Connection(cast("Any", None), 0, ""), "/robot/x", print).goal(too_many)
    listed = [list(goal) for goal in too_many]
    with pytest.raises(CairnError, match=words_in_order("mission", "at most 1000")):
        make_harness(f"components.mobile_supervisor.parameters.mission={listed}")


def test_progress_beyond_the_goals_is_ignored(make_harness: MakeHarness) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    number, _ = go(robot, [1.0, 2.0, 0.0])
    missions.take()
    publish_status(robot, mission_id=number, state=NavigationStatus.DRIVING, goal=2, goals=1)
    assert missions.take() == []


CANCELED = MissionResult(outcome=MissionOutcome.CANCELED, code=ReasonCode.CANCELED, reason="")


def a_mission(number: int = 1, **changes: Any) -> Mission:
    action = ActionRecord(name="navigate_through_poses", goal_id=f"{number:032x}")
    mission = Mission(mission_id=number, requested_ns=number, goals=GOALS, action=action)
    return mission.model_copy(update=changes)


def test_goals_are_written_once_and_progress_apart_from_them(tmp_path: Path) -> None:
    file = MissionFile(tmp_path / "mission.json")
    file.save(a_mission())
    written = file.file.stat()
    for first in (1, 2):
        file.save(a_mission(first=first))
    assert file.file.stat().st_ino == written.st_ino
    assert MissionFile(file.file).load() == a_mission(first=2)


def test_kill_between_goals_and_progress_leaves_the_new_mission_at_its_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = MissionFile(tmp_path / "mission.json")
    file.save(a_mission(1, first=7))

    def killed(path: Path, data: bytes) -> None:
        if path == file.progress_file:
            raise KeyboardInterrupt
        replace_file(path, data)

    monkeypatch.setattr(mission_file, "replace_file", killed)
    with pytest.raises(KeyboardInterrupt):
        file.save(a_mission(2))

    assert MissionFile(file.file).load() == a_mission(2)


@pytest.mark.parametrize(
    "after", [a_mission(1, result=CANCELED), a_mission(2)], ids=["ended", "preempted"]
)
def test_mission_that_is_over_is_not_continued_if_the_disk_takes_no_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: Mission
) -> None:
    file = MissionFile(tmp_path / "mission.json")
    file.save(a_mission(1, first=7))
    with monkeypatch.context() as full_disk:
        full_disk.setattr(mission_file, "replace_file", refuse)
        with pytest.raises(OSError, match="No space"):
            file.save(after)
    assert MissionFile(file.file).load() is None

    file.save(after)
    assert MissionFile(file.file).load() == after


def test_goal_on_a_full_disk_is_pursued_and_reported_as_lost_with_its_supervisor(
    make_harness: MakeHarness,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = make_harness()
    missions = robot.read("navigate_goal", NavigateGoal)
    kept, _ = go(robot, [1.0, 2.0, 0.0])
    with monkeypatch.context() as full_disk:
        full_disk.setattr(mission_file, "replace_file", refuse)
        publish_status(robot, mission_id=kept, state=NavigationStatus.FAILED, reason="no path")
        number, sent = go(robot, [3.0, 4.0, 0.0])
        assert [one.mission_id for one in missions.take()][-1] == number
        assert sent.result is None
        warning = caplog.messages[-1]
        assert_words(warning, "mission not saved", "No space left", f"mission {number} is lost")

        robot.request("root", "restart", name="mobile_supervisor")

    assert missions.take() == [], "nothing is continued"
    assert result_of(robot, sent).status == GoalStatus.STATUS_UNKNOWN


def refuse(path: Path, data: bytes) -> None:
    raise OSError(errno.ENOSPC, "No space left on device", str(path))
