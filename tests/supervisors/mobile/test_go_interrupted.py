"""Ctrl-C while `cairn go` waits cancels its own goal, and no other."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cairn.client.navigation import Navigator
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.supervisors.mobile.cli import follow
from cairn.testing.lockstep import DeploymentHarness
from tests.supervisors.mobile.test_mobile_supervisor import TREE, publish_status
from tests.wording import assert_words

GOALS = [[1.0, 2.0, 0.0]]


class InterruptedNavigator(Navigator):
    """The supervisor of a robot in lockstep, used by a client that is interrupted at `moment`."""

    def __init__(self, robot: DeploymentHarness, moment: str) -> None:
        self._robot = robot
        self._moment = moment

    def ask(self, verb: str, arguments: Mapping[str, Any], limit_s: float) -> Any:
        if verb == "go" and self._moment == "before it is sent":
            raise KeyboardInterrupt
        answer = self._robot.request("mobile_supervisor", verb, **arguments)
        if verb == "go" and self._moment == "before it is accepted":
            raise KeyboardInterrupt
        return answer

    @contextmanager
    def listen(self) -> Iterator[queue.Queue[Any]]:
        yield queue.Queue()

    def next_status(self, samples: object, wait_s: float) -> NavigationStatus | None:
        mission = self.last_mission()
        assert mission is not None
        if self._moment == "as it ends":
            publish_status(
                self._robot, mission_id=mission["mission_id"], state=NavigationStatus.SUCCEEDED
            )
        raise KeyboardInterrupt


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[DeploymentHarness]:
    file = tmp_path / "deployment.yaml"
    file.write_text(TREE, encoding="utf-8")
    robot = DeploymentHarness(file)
    yield robot
    robot.shutdown()


def last_mission(robot: DeploymentHarness) -> dict[str, Any]:
    mission: dict[str, Any] = robot.request("mobile_supervisor", "mission")
    return mission


@pytest.mark.parametrize("moment", ["before it is accepted", "while it is under way"])
def test_ctrl_c_cancels_the_goal_sent(
    robot: DeploymentHarness, capsys: pytest.CaptureFixture[str], moment: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        follow(InterruptedNavigator(robot, moment), GOALS, as_json=False)

    assert last_mission(robot)["result"] == "canceled: on request"
    assert capsys.readouterr().out.splitlines()[-1] == "canceled: the robot stops"


def test_ctrl_c_does_not_cancel_the_goal_of_another_client(
    robot: DeploymentHarness, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.request("mobile_supervisor", "go", goals=[[3.0, 4.0, 0.0]])

    with pytest.raises(KeyboardInterrupt):
        follow(InterruptedNavigator(robot, "before it is sent"), GOALS, as_json=False)

    assert last_mission(robot)["result"] == ""
    output = capsys.readouterr()
    assert "canceled: the robot stops" not in output.out
    assert_words(output.err, "nothing is canceled", "mobile_supervisor", "another client")


@pytest.mark.parametrize("as_json", [False, True])
def test_goal_that_ends_during_ctrl_c_keeps_its_result(
    robot: DeploymentHarness, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    with pytest.raises(KeyboardInterrupt):
        follow(InterruptedNavigator(robot, "as it ends"), GOALS, as_json=as_json)

    assert last_mission(robot)["result"] == "succeeded: "
    assert_words(capsys.readouterr().err, "nothing is canceled", "mobile_supervisor", "no mission")
