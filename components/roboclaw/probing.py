"""Looking at a RoboClaw without driving it, and turning its motors one by one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from cairn.components.roboclaw import commands
from cairn.components.roboclaw.commands import TIMEOUT_STEP_S
from cairn.components.roboclaw.dialogue import Dialogue, DialogueCounts
from cairn.components.roboclaw.kinematics import counted
from cairn.components.roboclaw.lines import open_line

_TIMEOUT_S = 0.3  # while motors turn
_REPLY_S = 0.25  # for a reply: here a person waits, and no wheel turns by what is late
_LOOK_S = 0.05
_SLOWING_S = 0.5  # for a motor to come to rest, before the next one


@contextmanager
def talking(port: str, baud: int, address: int) -> Iterator[Dialogue]:
    """A dialogue with the RoboClaw there; raises `DeviceError`."""
    link = open_line(port, baud)
    try:
        yield Dialogue(link, address, baud, DialogueCounts(), reply_limit_s=_REPLY_S)
    finally:
        link.close()


def facts(dialogue: Dialogue) -> dict[str, str]:
    """What it is and how it is, by name."""
    status = dialogue.status()
    low, high, *_ = dialogue.ask_either(commands.NEW_MAIN_VOLTAGES, commands.MAIN_VOLTAGES)
    (timeout,) = dialogue.ask(commands.TIMEOUT)
    told = {
        "version": dialogue.version(),
        "errors": ", ".join(status.errors) or "none",
        "warnings": ", ".join(status.warnings) or "none",
        "main battery": f"{dialogue.ask(commands.MAIN_VOLTAGE)[0] / 10:.1f} V, "
        f"limits {low / 10:.1f} to {high / 10:.1f} V",
        "logic battery": f"{dialogue.ask(commands.LOGIC_VOLTAGE)[0] / 10:.1f} V",
        "temperature": f"{dialogue.ask(commands.TEMPERATURE)[0] / 10:.1f} deg C",
        "serial timeout": f"{timeout * TIMEOUT_STEP_S:.1f} s" if timeout else "none",
    }
    for number, loop in enumerate(commands.SPEED_LOOPS, start=1):
        p, i, d, full_speed = dialogue.ask(loop)
        told[f"speed loop of M{number}"] = (
            f"P {p / 65536:.3f}, I {i / 65536:.3f}, D {d / 65536:.3f}, QPPS {full_speed}"
        )
    return told


def counts(dialogue: Dialogue) -> tuple[int, int]:
    """Both encoders' counters."""
    first, second = dialogue.ask(commands.ENCODERS)
    return first, second


def turn_motor(
    dialogue: Dialogue,
    motor: Literal["m1", "m2"],
    power: float,
    seconds: float,
    pause: Callable[[float], None] = time.sleep,
) -> tuple[int, int]:
    """Give a motor positive power for a time [s]; how far M1's and M2's encoders counted.

    It is switched off in the end whatever happens, by its own serial timeout if need be.
    """
    dialogue.order(commands.set_timeout(_TIMEOUT_S))
    before = counts(dialogue)
    until = time.monotonic() + seconds
    try:
        while time.monotonic() < until:
            dialogue.order(commands.give_power(*((power, 0.0) if motor == "m1" else (0.0, power))))
            pause(_LOOK_S)
        after = counts(dialogue)
    finally:
        dialogue.order(commands.switch_off())
    pause(_SLOWING_S)
    return counted(before[0], after[0]), counted(before[1], after[1])
