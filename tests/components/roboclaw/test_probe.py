"""`cairn driver probe base`: what it tells, and what it advises."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from cairn import CairnError
from cairn.components.roboclaw.probe_cli import base as probe
from cairn.components.roboclaw.wheel_advice import Direction, Turned, Wheel, advice
from tests.components.roboclaw.emulated_base import EmulatedBase, emulated_base


@pytest.fixture
def base(tmp_path: Path) -> Iterator[EmulatedBase]:
    with emulated_base(tmp_path) as base:
        yield base


def run(*words: str, answers: str = "") -> str:
    app = typer.Typer()
    app.command()(probe)
    result = CliRunner().invoke(app, words, input=answers, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return str(result.output)


def test_it_tells_what_the_controller_is_and_how(base: EmulatedBase) -> None:
    base.device.controller.emergency_stop = True

    told = run(str(base.path), "--seconds", "0.1")

    assert "USB Roboclaw 2x7a v4.2.8" in told
    assert "errors             emergency stop" in told
    assert "main battery       12.4 V, limits 6.0 to 34.0 V" in told
    assert "serial timeout     none" in told
    assert "M1  4294966796 (+0/s)   M2         300 (+0/s)" in told


def test_turning_wheels_leads_to_parameters(base: EmulatedBase) -> None:
    told = run(str(base.path), "--turn-wheels", answers="y\nr\na\nl\nb\n")

    assert "M1 +" in told
    assert "left: m2\n  left_inverted: true\n  right_inverted: false" in told
    assert base.await_stand(2.0)


def test_nothing_turns_without_consent(base: EmulatedBase) -> None:
    app = typer.Typer()
    app.command()(probe)

    result = CliRunner().invoke(app, [str(base.path), "--turn-wheels"], input="n\n")

    assert result.exit_code == 1
    assert all(motor.turned == 0.0 for motor in base.device.controller.motors)


def test_turning_wheels_and_json_exclude_each_other() -> None:
    with pytest.raises(CairnError, match="cannot be told as --json"):
        run("/dev/nothing", "--turn-wheels", "--json")


def turned(
    motor: str = "m1",
    counts: int = 500,
    other: int = 0,
    wheel: Wheel = "left",
    direction: Direction = "ahead",
) -> Turned:
    return Turned("m1" if motor == "m1" else "m2", counts, other, wheel, direction)


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        (turned(counts=-500), turned("m2", wheel="right"), "M1: its encoder counts against"),
        (turned(), turned("m2", counts=3, wheel="right"), "M2: .* its encoder does not count"),
        (turned(counts=0, other=400), turned("m2", wheel="right"), "M1: the other motor's"),
        (turned(wheel="none"), turned("m2", wheel="right"), "M1: no wheel turns"),
        (turned(), turned("m2"), "both motors turned the left wheel"),
    ],
)
def test_what_is_wired_wrongly_is_named(first: Turned, second: Turned, told: str) -> None:
    (line,) = advice([first, second])

    assert re.search(told, line), line
