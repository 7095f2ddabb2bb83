"""`cairn driver probe base`: looks at a RoboClaw, and turns its wheels if asked to."""

from __future__ import annotations

import time
from typing import Annotated, Literal

import typer

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json
from cairn.components.roboclaw.dialogue import Dialogue
from cairn.components.roboclaw.kinematics import counted
from cairn.components.roboclaw.packets import ADDRESSES
from cairn.components.roboclaw.probing import counts, facts, talking, turn_motor
from cairn.components.roboclaw.wheel_advice import Direction, Turned, Wheel, advice

_EVERY_S = 0.5
_TURN_S = 1.0
_WHEELS: dict[str, Wheel] = {"l": "left", "r": "right", "n": "none"}
_DIRECTIONS: dict[str, Direction] = {"a": "ahead", "b": "back"}


def base(
    port: Annotated[
        str,
        typer.Argument(help="Serial port: a path, usb:VENDOR:PRODUCT[:SERIAL], or tcp:HOST:PORT."),
    ] = "usb:03eb:2404",
    baud: Annotated[int, typer.Option(min=2400, help="Of the line [bit/s].")] = 115200,
    address: Annotated[
        int, typer.Option(min=ADDRESSES[0], max=ADDRESSES[-1], help="Of the RoboClaw.")
    ] = ADDRESSES[0],
    seconds: Annotated[
        float, typer.Option(min=0.0, max=3600, help="How long its encoders are watched [s].")
    ] = 3.0,
    turn_wheels: Annotated[
        bool,
        typer.Option("--turn-wheels", help="Turn each wheel, to find channel, direction and sign."),
    ] = False,
    power: Annotated[
        float, typer.Option(min=0.02, max=0.5, help="Share of full power to turn wheels with.")
    ] = 0.15,
    json: Json = False,
) -> None:
    """Look at a base on a RoboClaw: version, battery, status, encoders while you turn its wheels.

    For example: cairn driver probe base /dev/serial/by-id/usb-03eb_USB_Roboclaw_2x7A-if00
    """
    if turn_wheels and json:
        raise CairnError("--turn-wheels asks what you see, so it cannot be told as --json")
    with talking(port, baud, address) as dialogue:
        told = facts(dialogue)
        if json:
            first, second = counts(dialogue)
            print_json({**told, "counts": [first, second]})
            return
        for name, value in told.items():
            line(f"{name:18} {value}")
        if turn_wheels:
            _turn_wheels(dialogue, power)
        else:
            _watch(dialogue, seconds)


def _watch(dialogue: Dialogue, seconds: float) -> None:
    if seconds:
        note("turn the wheels by hand: ahead, both have to count upwards (inverted: downwards)")
    before = counts(dialogue)
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        time.sleep(_EVERY_S)  # as the operator watches
        now = counts(dialogue)
        speeds = [counted(a, b) / _EVERY_S for a, b in zip(before, now, strict=True)]
        line(f"M1 {now[0]:11d} ({speeds[0]:+.0f}/s)   M2 {now[1]:11d} ({speeds[1]:+.0f}/s)")
        before = now


def _turn_wheels(dialogue: Dialogue, power: float) -> None:
    note("the wheels are going to turn: jack the base up, and stay clear of them")
    typer.confirm("turn them now?", abort=True)
    line("\n".join(advice([_turned(dialogue, "m1", power), _turned(dialogue, "m2", power)])))


def _turned(dialogue: Dialogue, motor: Literal["m1", "m2"], power: float) -> Turned:
    first, second = turn_motor(dialogue, motor, power, _TURN_S)
    line(
        f"{motor.upper()} was given {power:.0%} of its power: M1 {first:+d}, M2 {second:+d} counts"
    )
    wheel = _WHEELS[_asked("which wheel turned: left, right, none", tuple(_WHEELS))]
    direction: Direction = "ahead"
    if wheel != "none":
        direction = _DIRECTIONS[_asked("as if going ahead, or back", tuple(_DIRECTIONS))]
    own, other = (first, second) if motor == "m1" else (second, first)
    return Turned(motor, own, other, wheel, direction)


def _asked(question: str, letters: tuple[str, ...]) -> str:
    while True:
        answer: str = typer.prompt(f"{question} ({'/'.join(letters)})")
        if answer[:1].lower() in letters:
            return answer[:1].lower()
