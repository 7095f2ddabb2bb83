"""`cairn driver probe base`: the facts that it shows, and its advice on wiring."""

import re
from functools import partial

import pytest
import typer
from typer.testing import CliRunner

from cairn import CairnError
from cairn.components.roboclaw_base import probe_cli
from cairn.components.roboclaw_base.probe_cli import Direction, MotorTrial, Wheel, wiring_advice
from cairn.components.roboclaw_base.probe_cli import base as probe
from tests.components.roboclaw_base.virtual_base import VirtualBase

PORT = "/dev/roboclaw"


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> VirtualBase:
    base = VirtualBase(monkeypatch)
    monkeypatch.setattr(probe_cli, "open_line", base.open)
    monkeypatch.setattr(probe_cli, "turn_motor", partial(probe_cli.turn_motor, pause=base.sleep))
    return base


def run(*words: str, answers: str = "") -> str:
    app = typer.Typer()
    app.command()(probe)
    result = CliRunner().invoke(app, words, input=answers, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return str(result.output)


def test_version_status_and_counters_are_shown(base: VirtualBase) -> None:
    base.device.controller.emergency_stop = True

    output = run(PORT, "--seconds", "0.1")

    assert "USB Roboclaw 2x7a v4.2.8" in output
    assert "errors             emergency stop" in output
    assert "main battery       12.4 V, limits 6.0 to 34.0 V" in output
    assert "serial timeout     none" in output
    assert "M1  4294966796 (+0/s)   M2         300 (+0/s)" in output


def test_turning_the_wheels_yields_parameters(base: VirtualBase) -> None:
    output = run(PORT, "--turn-wheels", answers="y\nr\nf\nl\nb\n")

    assert "M1 +" in output
    assert "left: m2\n  left_inverted: true\n  right_inverted: false" in output
    assert base.await_stand(2.0)


def test_nothing_turns_without_confirmation(base: VirtualBase) -> None:
    app = typer.Typer()
    app.command()(probe)

    result = CliRunner().invoke(app, [PORT, "--turn-wheels"], input="n\n")

    assert result.exit_code == 1
    assert all(motor.turned == 0.0 for motor in base.device.controller.motors)


def test_turning_wheels_and_json_exclude_each_other() -> None:
    with pytest.raises(CairnError, match="--turn-wheels asks questions"):
        run("/dev/nothing", "--turn-wheels", "--json")


def trial(
    motor: str = "m1",
    counts: int = 500,
    other: int = 0,
    wheel: Wheel = "left",
    direction: Direction = "forward",
) -> MotorTrial:
    return MotorTrial("m1" if motor == "m1" else "m2", counts, other, wheel, direction)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (trial(counts=-500), trial("m2", wheel="right"), "M1: its encoder counts against"),
        (trial(), trial("m2", counts=3, wheel="right"), "M2: .* its encoder does not count"),
        (trial(counts=0, other=400), trial("m2", wheel="right"), "M1: the other motor's"),
        (trial(wheel="none"), trial("m2", wheel="right"), "M1: no wheel turns"),
        (trial(), trial("m2"), "both motors turned the left wheel"),
    ],
)
def test_wrong_wiring_is_named(first: MotorTrial, second: MotorTrial, message: str) -> None:
    (line,) = wiring_advice([first, second])

    assert re.search(message, line), line
