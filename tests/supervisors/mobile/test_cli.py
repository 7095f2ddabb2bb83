"""Goals on the command line."""

import math

import pytest

from cairn.errors import CairnError
from supervisors.mobile.cli import parse_goals
from tests.commands import cairn


@pytest.mark.parametrize(
    ("words", "goals"),
    [
        (["7.5", "5.0"], [[7.5, 5.0, 0.0]]),
        (["7.5", "5.0", "90deg"], [[7.5, 5.0, math.pi / 2]]),
        (["-7.5", "-5", "-1.5"], [[-7.5, -5.0, -1.5]]),
        (["1,2", "3,4,180deg"], [[1.0, 2.0, 0.0], [3.0, 4.0, math.pi]]),
        (["-1,-2,-90deg"], [[-1.0, -2.0, -math.pi / 2]]),
        (["1", "2", "370deg"], [[1.0, 2.0, math.radians(10)]]),
    ],
)
def test_goals_are_read(words: list[str], goals: list[list[float]]) -> None:
    assert parse_goals(words) == [pytest.approx(goal) for goal in goals]


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
    ],
)
def test_what_is_no_goal_is_refused(words: list[str], why: str) -> None:
    with pytest.raises(CairnError, match=why):
        parse_goals(words)


def test_a_goal_together_with_cancel_is_refused_before_anything_is_asked() -> None:
    answer = cairn("go", "1", "2", "--cancel")
    assert (answer.code, answer.err) == (1, "cairn: give a goal or --cancel, not both\n")


def test_without_a_deployment_it_says_so() -> None:
    answer = cairn("go", "1", "-2", "--connect", "tcp/127.0.0.1:1")
    assert answer.code == 1
    assert "tcp/127.0.0.1:1" in answer.err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["1"], "place 1: write it as X Y [HEADING]"),
        (["1", "-two"], "place 1 -two: '-two' is not a number"),
        (["1", "2", "inf"], "place 1 2 inf: inf must be finite"),
    ],
)
def test_what_is_no_place_is_refused_before_anything_is_told(words: list[str], why: str) -> None:
    answer = cairn("locate", *words)
    assert (answer.code, answer.err) == (1, f"cairn: {why}\n")
