"""Ctrl-C while `cairn go` waits cancels its own goal, and no other."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cairn.bus.actions import CANCEL_GOAL, ActionCaller, SentGoal, make_at_once
from cairn.client.navigation import MissionClient, PlanarPose
from cairn.planar.messages import pose_message
from cairn.schemas.action_msgs.msg import GoalInfo, GoalStatus
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.cairn_nav_msgs import NavigateGoal, NavigationStatus
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav2_msgs.action import NavigateThroughPoses
from cairn.supervisors.mobile.cli import follow
from cairn.testing.lockstep import DeploymentHarness
from tests.supervisors.mobile.test_mobile_supervisor import TREE, go, publish_status
from tests.wording import assert_words

GOALS = [[1.0, 2.0, 0.0]]


class LockstepGoal:
    """A goal that was sent to the robot in lockstep, as the client has one over the network."""

    def __init__(self, sent: SentGoal[Any, Any, Any], moment: str) -> None:
        self.sent = sent
        self._moment = moment

    def await_acceptance(self) -> None:
        if self._moment == "before it is accepted":
            self._moment = ""
            raise KeyboardInterrupt
        assert self.sent.is_accepted

    def await_end(self, timeout_s: float) -> bool:
        return self.sent.has_ended

    def close(self) -> None:
        """Nothing is to be closed."""


class InterruptedMissions(MissionClient):
    """The supervisor of a robot in lockstep, used by a client that is interrupted at `moment`."""

    def __init__(self, robot: DeploymentHarness, moment: str) -> None:
        self._supervisor = "/robot/mobile_supervisor"
        self._deployment = robot
        self._missions = robot.read("navigate_goal", NavigateGoal)
        self._moment = moment
        self.goals: list[LockstepGoal] = []

    def send(self, poses: Sequence[PlanarPose], identity: bytes) -> Any:
        if self._moment == "before it is sent":
            raise KeyboardInterrupt
        caller = ActionCaller(
            "/robot/navigate_through_poses",
            NavigateThroughPoses,
            lambda name, service: self._deployment.node.client(name, service, make_at_once),
        )
        message = NavigateThroughPoses.Goal(
            poses=tuple(PoseStamped(pose=pose_message(pose)) for pose in poses)
        )
        self.goals.append(LockstepGoal(caller.send(identity, message), self._moment))
        self._deployment.run_for(0.0)
        return self.goals[-1]

    def _cancel(self, actions: Sequence[str], wanted: GoalInfo) -> list[GoalInfo]:
        request = CancelGoal.Request(goal_info=wanted)
        (action,) = actions
        answer = self._deployment.call(f"{action}/{CANCEL_GOAL}", CancelGoal, request)
        return list(answer.goals_canceling)

    @contextmanager
    def listen(self) -> Iterator[queue.Queue[Any]]:
        yield queue.Queue()

    def next_status(self, samples: object, wait_s: float) -> NavigationStatus | None:
        if self._moment == "as it ends":
            number = self._missions.take()[-1].mission_id
            publish_status(self._deployment, mission_id=number, state=NavigationStatus.SUCCEEDED)
        raise KeyboardInterrupt


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[DeploymentHarness]:
    file = tmp_path / "deployment.yaml"
    file.write_text(TREE, encoding="utf-8")
    robot = DeploymentHarness(file)
    robot.start()
    yield robot
    robot.shutdown()


@pytest.mark.parametrize("moment", ["before it is accepted", "while it is under way"])
def test_ctrl_c_cancels_the_goal_sent(
    robot: DeploymentHarness, capsys: pytest.CaptureFixture[str], moment: str
) -> None:
    missions = InterruptedMissions(robot, moment)
    with pytest.raises(KeyboardInterrupt):
        follow(missions, GOALS, as_json=False)

    assert missions.goals[0].sent.status == GoalStatus.STATUS_CANCELED
    assert capsys.readouterr().out.splitlines()[-1] == "canceled: the robot stops"


def test_ctrl_c_does_not_cancel_the_goal_of_another_client(
    robot: DeploymentHarness, capsys: pytest.CaptureFixture[str]
) -> None:
    _, of_another = go(robot, [3.0, 4.0, 0.0])

    with pytest.raises(KeyboardInterrupt):
        follow(InterruptedMissions(robot, "before it is sent"), GOALS, as_json=False)

    assert not of_another.has_ended
    output = capsys.readouterr()
    assert "canceled: the robot stops" not in output.out
    assert_words(output.err, "nothing is canceled", "mobile_supervisor", "not under way")


@pytest.mark.parametrize("as_json", [False, True])
def test_goal_that_ends_during_ctrl_c_keeps_its_result(
    robot: DeploymentHarness, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    missions = InterruptedMissions(robot, "as it ends")
    with pytest.raises(KeyboardInterrupt):
        follow(missions, GOALS, as_json=as_json)

    assert missions.goals[0].sent.status == GoalStatus.STATUS_SUCCEEDED
    assert_words(
        capsys.readouterr().err, "nothing is canceled", "mobile_supervisor", "not under way"
    )
