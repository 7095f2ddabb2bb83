"""`cairn driver probe base`: reads a RoboClaw, and turns its motors to check its wiring."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

import typer

from cairn import CairnError
from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.client import PacketCounts, RoboclawClient, open_line
from cairn.components.roboclaw_base.kinematics import MotorChannel, count_difference
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json

Wheel = Literal["left", "right", "none"]
Direction = Literal["forward", "back"]

_INTERVAL_S = 0.5
_TURN_S = 1.0
_WHEELS: dict[str, Wheel] = {"l": "left", "r": "right", "n": "none"}
_DIRECTIONS: dict[str, Direction] = {"f": "forward", "b": "back"}
_FEWEST_COUNTS = 20  # a shaft that trembles gives fewer
_TIMEOUT_S = 0.3  # serial timeout while motors turn
_REPLY_TIMEOUT_S = 0.25  # longer than the driver's: no wheel depends on a prompt reply here
_COMMAND_INTERVAL_S = 0.05
_STOPPING_S = 0.5  # for a motor to come to rest, before the next one


@dataclass(frozen=True)
class MotorTrial:
    """What was observed when one motor got positive power."""

    motor: MotorChannel
    counts: int
    """How far its encoder counted."""
    other_counts: int
    """How far the encoder of the other motor, which was off, counted."""
    wheel: Wheel
    """The wheel that the operator saw turn."""
    direction: Direction
    """The direction in which that wheel would have moved the base."""


def base(
    port: Annotated[
        str,
        typer.Argument(help="Serial port: a path, usb:VENDOR:PRODUCT[:SERIAL], or tcp:HOST:PORT."),
    ] = "usb:03eb:2404",
    baud: Annotated[int, typer.Option(min=2400, help="Speed of the line [bit/s].")] = 115200,
    address: Annotated[
        int,
        typer.Option(
            min=protocol.ADDRESSES[0],
            max=protocol.ADDRESSES[-1],
            help="Address of the RoboClaw; any over USB.",
        ),
    ] = protocol.ADDRESSES[0],
    seconds: Annotated[
        float, typer.Option(min=0.0, max=3600, help="How long to show the encoders [s].")
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
    """Show version, battery and status of a RoboClaw, and its encoders while you turn the wheels.

    For example: cairn driver probe base /dev/serial/by-id/usb-03eb_USB_Roboclaw_2x7A-if00
    """
    if turn_wheels and json:
        raise CairnError("--turn-wheels asks questions, so it has no --json; leave one of them out")
    with connect(port, baud, address) as client:
        facts = read_facts(client)
        if json:
            first, second = read_counts(client)
            print_json({**facts, "counts": [first, second]})
            return
        for name, value in facts.items():
            line(f"{name:18} {value}")
        if turn_wheels:
            _turn_wheels(client, power)
        else:
            _show_encoders(client, seconds)


@contextmanager
def connect(port: str, baud: int, address: int) -> Iterator[RoboclawClient]:
    """Open the line to a RoboClaw for the time of a context; raises `DeviceError`."""
    link = open_line(port, baud)
    try:
        yield RoboclawClient(link, address, baud, PacketCounts(), reply_timeout_s=_REPLY_TIMEOUT_S)
    finally:
        link.close()


def read_facts(client: RoboclawClient) -> dict[str, str]:
    """Read version, status, voltages, temperature and settings, by name."""
    status = client.status()
    low, high, *_ = client.read_either(protocol.NEW_MAIN_VOLTAGES, protocol.MAIN_VOLTAGES)
    (timeout,) = client.read(protocol.TIMEOUT)
    facts = {
        "version": client.version(),
        "errors": ", ".join(status.errors) or "none",
        "warnings": ", ".join(status.warnings) or "none",
        "main battery": f"{client.read(protocol.MAIN_VOLTAGE)[0] / 10:.1f} V, "
        f"limits {low / 10:.1f} to {high / 10:.1f} V",
        "logic battery": f"{client.read(protocol.LOGIC_VOLTAGE)[0] / 10:.1f} V",
        "temperature": f"{client.read(protocol.TEMPERATURE)[0] / 10:.1f} deg C",
        "serial timeout": f"{timeout * protocol.TIMEOUT_STEP_S:.1f} s" if timeout else "none",
    }
    for number, loop in enumerate(protocol.SPEED_LOOPS, start=1):
        p, i, d, full_speed = client.read(loop)
        facts[f"speed loop of M{number}"] = (
            f"P {p / 65536:.3f}, I {i / 65536:.3f}, D {d / 65536:.3f}, QPPS {full_speed}"
        )
    return facts


def read_counts(client: RoboclawClient) -> tuple[int, int]:
    """Read both encoders' counters."""
    first, second = client.read(protocol.ENCODERS)
    return first, second


def turn_motor(
    client: RoboclawClient,
    motor: MotorChannel,
    power: float,
    seconds: float,
    pause: Callable[[float], None] = time.sleep,
) -> tuple[int, int]:
    """Turn a motor with positive power for a time [s]; return how far M1 and M2 counted.

    It is switched off at the end in any case, if need be by its own serial timeout.
    """
    client.write(protocol.set_timeout(_TIMEOUT_S))
    before = read_counts(client)
    deadline = time.monotonic() + seconds
    try:
        while time.monotonic() < deadline:
            duties = (power, 0.0) if motor == "m1" else (0.0, power)
            client.write(protocol.drive_duty(*duties))
            pause(_COMMAND_INTERVAL_S)
        after = read_counts(client)
    finally:
        client.write(protocol.switch_off())
    pause(_STOPPING_S)
    return count_difference(before[0], after[0]), count_difference(before[1], after[1])


def wiring_advice(trials: Sequence[MotorTrial]) -> list[str]:
    """Return what to rewire; if nothing, the parameters to set."""
    faults = [fault for trial in trials for fault in _wiring_faults(trial)]
    wheels = [trial.wheel for trial in trials]
    if "none" not in wheels and sorted(wheels) != ["left", "right"]:
        faults.append(f"both motors turned the {wheels[0]} wheel by your answers: try again")
    return faults or _parameters(trials)


def _wiring_faults(trial: MotorTrial) -> list[str]:
    name = trial.motor.upper()
    if trial.wheel == "none":
        return [f"{name}: no wheel turns: check its motor's leads, and the battery"]
    if abs(trial.counts) < _FEWEST_COUNTS:
        if abs(trial.other_counts) >= _FEWEST_COUNTS:
            return [f"{name}: the other motor's encoder counts: exchange the encoders' plugs"]
        return [f"{name}: its wheel turns, but its encoder does not count: check its cable"]
    if trial.counts < 0:
        return [
            f"{name}: its encoder counts against its motor, which would run away: exchange the "
            "encoder's lines A and B, or the motor's leads, or reverse one of them in Motion Studio"
        ]
    return []


def _parameters(trials: Sequence[MotorTrial]) -> list[str]:
    lines = ["set these parameters of roboclaw_base:"]
    for trial in sorted(trials, key=lambda trial: trial.wheel):
        if trial.wheel == "left":
            lines.append(f"  left: {trial.motor}")
        inverted = "true" if trial.direction == "back" else "false"
        lines.append(f"  {trial.wheel}_inverted: {inverted}")
    return lines


def _show_encoders(client: RoboclawClient, seconds: float) -> None:
    if seconds:
        note("turn the wheels forward by hand: both must count upwards (inverted: downwards)")
    before = read_counts(client)
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        time.sleep(_INTERVAL_S)  # a display for the operator
        now = read_counts(client)
        pairs = zip(before, now, strict=True)
        speeds = [count_difference(first, last) / _INTERVAL_S for first, last in pairs]
        line(f"M1 {now[0]:11d} ({speeds[0]:+.0f}/s)   M2 {now[1]:11d} ({speeds[1]:+.0f}/s)")
        before = now


def _turn_wheels(client: RoboclawClient, power: float) -> None:
    note("the wheels are going to turn: jack the base up, and stay clear of them")
    typer.confirm("turn them now?", abort=True)
    line(
        "\n".join(wiring_advice([_try_motor(client, "m1", power), _try_motor(client, "m2", power)]))
    )


def _try_motor(client: RoboclawClient, motor: MotorChannel, power: float) -> MotorTrial:
    first, second = turn_motor(client, motor, power, _TURN_S)
    line(f"{motor.upper()} got {power:.0%} of its power: M1 {first:+d}, M2 {second:+d} counts")
    wheel = _WHEELS[_ask("which wheel turned: left, right, none", tuple(_WHEELS))]
    direction: Direction = "forward"
    if wheel != "none":
        direction = _DIRECTIONS[_ask("in which direction: forward, back", tuple(_DIRECTIONS))]
    own, other = (first, second) if motor == "m1" else (second, first)
    return MotorTrial(motor, own, other, wheel, direction)


def _ask(question: str, letters: tuple[str, ...]) -> str:
    while True:
        answer: str = typer.prompt(f"{question} ({'/'.join(letters)})")
        if answer[:1].lower() in letters:
            return answer[:1].lower()
