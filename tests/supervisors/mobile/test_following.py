"""Ctrl-C while `cairn go` waits: it takes back its own order, and nobody else's."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cairn.deployment.load import load_deployment
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.supervisors.mobile.following import Operator, follow
from tests.navigation.deployed import Deployed
from tests.supervisors.mobile.test_mobile_supervisor import TREE, tell

GOALS = [[1.0, 2.0, 0.0]]


class AtTheTerminal(Operator):
    """An operator of a robot in lockstep who presses Ctrl-C at some moment."""

    def __init__(self, robot: Deployed, pressed: str) -> None:
        self._robot = robot
        self._pressed = pressed
        self._token = "mine"

    def _ask(self, verb: str, arguments: dict[str, Any], limit_s: float) -> Any:
        return self._robot.ask("mobile_supervisor", verb, **arguments)

    def go(self, goals: Sequence[Sequence[float]]) -> int:
        if self._pressed == "before it is asked":
            raise KeyboardInterrupt
        order = super().go(goals)
        if self._pressed == "before it is answered":
            raise KeyboardInterrupt
        return order

    @contextmanager
    def statuses(self) -> Iterator[queue.Queue[Any]]:
        yield queue.Queue()

    def next_status(self, samples: queue.Queue[Any], wait_s: float) -> NavigationStatus | None:
        order = self.order()
        assert order is not None
        if self._pressed == "as it ends":
            tell(self._robot, mission_id=order["mission_id"], state=NavigationStatus.SUCCEEDED)
        raise KeyboardInterrupt


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Deployed]:
    file = tmp_path / "deployment.yaml"
    file.write_text(TREE, encoding="utf-8")
    robot = Deployed(load_deployment(file))
    yield robot
    robot.end()


def last_order(robot: Deployed) -> dict[str, Any]:
    order: dict[str, Any] = robot.ask("mobile_supervisor", "mission")
    return order


@pytest.mark.parametrize("moment", ["before it is answered", "while it is under way"])
def test_the_order_given_is_taken_back(
    robot: Deployed, capsys: pytest.CaptureFixture[str], moment: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        follow(AtTheTerminal(robot, moment), GOALS, as_json=False)

    assert last_order(robot)["result"] == "canceled: on request"
    assert capsys.readouterr().out.splitlines()[-1] == "canceled: the robot stops"


def test_anothers_order_goes_on(robot: Deployed, capsys: pytest.CaptureFixture[str]) -> None:
    robot.ask("mobile_supervisor", "go", goals=[[3.0, 4.0, 0.0]])

    with pytest.raises(KeyboardInterrupt):
        follow(AtTheTerminal(robot, "before it is asked"), GOALS, as_json=False)

    assert last_order(robot)["result"] == ""
    said = capsys.readouterr()
    assert "canceled: the robot stops" not in said.out
    assert said.err == (
        "nothing is canceled: mobile_supervisor: it is another's order that is under way\n"
    )


@pytest.mark.parametrize("as_json", [False, True])
def test_an_order_that_ends_at_that_moment_keeps_its_result(
    robot: Deployed, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    with pytest.raises(KeyboardInterrupt):
        follow(AtTheTerminal(robot, "as it ends"), GOALS, as_json=as_json)

    assert last_order(robot)["result"] == "succeeded: "
    assert capsys.readouterr().err == (
        "nothing is canceled: mobile_supervisor: there is no order to cancel\n"
    )
