"""Goals on the command line."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from cairn import CairnError
from cairn.client import Connection, navigation
from cairn.client.navigation import MissionClient
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.supervisors.mobile.cli import cause_of, parse_goals, print_progress, progress_line
from cairn.testing.launching import new_endpoint
from tests.cairn.bus.network import router_at
from tests.commands import cairn
from tests.wording import assert_words


@pytest.fixture
def bus() -> Iterator[str]:
    """Endpoint of a router without a deployment."""
    endpoint = new_endpoint()
    router = router_at(endpoint)
    yield endpoint
    router.close()


@pytest.mark.parametrize(
    ("words", "goals"),
    [
        (["7.5", "5.0"], [[7.5, 5.0, 0.0]]),
        (["7.5", "5.0", "90deg"], [[7.5, 5.0, math.pi / 2]]),
        (["-7.5", "-5", "-1.5"], [[-7.5, -5.0, -1.5]]),
        (["1,2", "3,4,180deg"], [[1.0, 2.0, 0.0], [3.0, 4.0, math.pi]]),
        (["-1,-2,-90deg"], [[-1.0, -2.0, -math.pi / 2]]),
        (["1", "2", "370deg"], [[1.0, 2.0, math.radians(10)]]),
        (["kitchen"], ["kitchen"]),
        (["meeting room", "dock"], ["meeting room", "dock"]),
        (["kitchen", "1,2", "dock"], ["kitchen", [1.0, 2.0, 0.0], "dock"]),
        (["1,2", "dock"], [[1.0, 2.0, 0.0], "dock"]),
    ],
)
def test_goals_are_parsed(words: list[str], goals: list[list[float] | str]) -> None:
    parsed = parse_goals(words)
    assert parsed == [one if isinstance(one, str) else pytest.approx(one) for one in goals]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ([], "give a goal, such as `cairn go 7.5 5.0 90deg`"),
        (["1"], "write it as X Y"),
        (["1", "2", "3", "4"], "write it as X Y"),
        (["1", "two"], "goal 1 two: 'two' is not a number"),
        (["1", "nan"], "goal 1 nan: nan must be finite"),
        (["1", "2", "infdeg"], "inf must be finite"),
        (["1,2", "3"], "goal 3: write it as X Y"),
        (["1", "2", "--cancle"], "'--cancle' is not a number"),
        (["kitchen", "3"], "goal 3: write it as X Y"),
        (["--cancle"], "goal --cancle: write it as X Y"),
        (["nan", "1"], "goal nan 1: nan must be finite"),
    ],
)
def test_invalid_goal_is_rejected(words: list[str], why: str) -> None:
    with pytest.raises(CairnError, match=why):
        parse_goals(words)


def test_a_cause_is_printed_once() -> None:
    cause, printed, lines = "no path: a person 1.5 m ahead", "", []
    for words in ("wait (1 of 4)", "give way (2 of 4)", "go near (3 of 4)"):
        status = NavigationStatus(state=NavigationStatus.RECOVERING, reason=f"{words}: {cause}")
        lines.append(progress_line(status, printed))
        printed, cause = cause_of(status), cause.replace("1.5", "1.4")

    assert lines == [
        "   0.0 s  recovering: wait (1 of 4): no path: a person 1.5 m ahead",
        "   0.0 s  recovering: give way (2 of 4)",
        "   0.0 s  recovering: go near (3 of 4)",
    ]


def test_what_holds_the_robot_is_printed_as_long_as_it_does() -> None:
    status = NavigationStatus(state=NavigationStatus.DRIVING, distance_left=4.8, time_left=12.0)
    held = replace(status, reason="stopped by the velocity gate: emergency stop")

    assert progress_line(status) == "   0.0 s  driving: 4.8 m left, about 12 s"
    again = progress_line(held, held.reason)
    assert (
        again == "   0.0 s  driving: 4.8 m left, but stopped by the velocity gate: emergency stop"
    )


class Statuses:
    """A goal whose progress is given."""

    ended = False

    def __init__(self, *statuses: tuple[int, str]) -> None:
        self._statuses = statuses

    def __iter__(self) -> Iterator[NavigationStatus]:
        for state, reason in self._statuses:
            yield NavigationStatus(state=state, reason=reason)


def test_a_cause_that_returns_after_a_recovery_is_not_printed_again(
    capsys: pytest.CaptureFixture[str],
) -> None:
    planning = (NavigationStatus.PLANNING, "no path: the goal is in unknown space")
    recovering = (NavigationStatus.RECOVERING, f"wait (1 of 4): {planning[1]}")
    goal: Any = Statuses(planning, recovering, (NavigationStatus.LOCALIZING, ""), planning)

    print_progress(goal, as_json=False)

    assert capsys.readouterr().out.count("unknown space") == 1


def test_goal_together_with_cancel_is_rejected() -> None:
    answer = cairn("go", "1", "2", "--cancel")
    assert answer.code == 1
    assert_words(answer.err, "cairn", "goal", "--cancel")


def test_without_a_deployment_the_endpoint_is_reported() -> None:
    answer = cairn("go", "1", "-2", "--connect", "tcp/127.0.0.1:1")
    assert answer.code == 1
    assert "tcp/127.0.0.1:1" in answer.err


def test_missing_mobile_supervisor_is_reported_as_json_too(bus: str) -> None:
    answer = cairn("go", "1", "2", "--json", connect=bus)

    assert answer.code == 1
    assert answer.json["state"] == "refused"
    assert answer.json["reason"].startswith("no mobile_supervisor runs here")
    assert answer.err == f"cairn: {answer.json['reason']}\n"


def test_silent_supervisor_is_reported_with_the_way_to_stop_the_robot(
    bus: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(navigation, "PATIENCE_S", 0.0)
    connection = Connection.open(bus)
    remarks: list[str] = []
    with pytest.raises(CairnError) as refused:
        MissionClient(connection, "/robot/mobile_supervisor", remarks.append).await_active()
    connection.close()
    assert "mobile_supervisor does not answer" in remarks[0]
    assert str(refused.value).startswith("mobile_supervisor has not answered for 0 s")
    assert "press Ctrl-C twice where `cairn up` runs" in str(refused.value)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["1"], "pose 1: write it as X Y [HEADING]"),
        (["1", "-two"], "pose 1 -two: '-two' is not a number"),
        (["1", "2", "inf"], "pose 1 2 inf: inf must be finite"),
    ],
)
def test_invalid_pose_is_rejected_before_anything_is_published(words: list[str], why: str) -> None:
    answer = cairn("locate", *words)
    assert (answer.code, answer.err) == (1, f"cairn: {why}\n")
