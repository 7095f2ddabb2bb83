"""How a RoboClaw is: what is asked of it between its orders, and what is known of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from cairn.components.roboclaw import commands
from cairn.components.roboclaw.dialogue import Dialogue, DialogueCounts
from cairn.components.roboclaw.setting_up import check_timeout
from cairn.components.roboclaw.status import Status
from cairn.driver.errors import DeviceError


@dataclass
class Health:
    """What is known of the controller. Written by the conversation, read by whoever tells of it."""

    version: str = ""
    status: Status = field(default_factory=Status)
    voltage: float = math.nan
    """Main battery [V]."""
    currents: tuple[float, float] = (math.nan, math.nan)
    """Of M1 and M2 [A]."""
    temperature: float = math.nan
    """[deg C]"""
    fault: str | None = None
    """What was wrong with a wheel; from then on the motors are off."""
    trouble: str | None = "it is not connected yet"
    """Why there is no conversation; None if there is one."""
    awaits_rest: bool = False
    """Whether the command has to be rest, or to cease, once before the wheels turn again."""
    connections: int = 0
    counts: DialogueCounts = field(default_factory=DialogueCounts)


class RetryShare:
    """Which share of the packets had to be sent again lately."""

    def __init__(self) -> None:
        self._packets = self._retries = 0

    def since_last(self, counts: DialogueCounts) -> float:
        """Of those since this was asked last [1]."""
        packets, retries = counts.packets - self._packets, counts.retries - self._retries
        self._packets, self._retries = counts.packets, counts.retries
        return retries / packets if packets else 0.0


def asking(dialogue: Dialogue, health: Health, timeout_s: float) -> tuple[Callable[[], None], ...]:
    """Questions to be asked in turns, one each time that the wheels are ordered.

    They write what they learn into `health`. The status comes every other time: it stops the base.
    They raise `DeviceError`, too, if the serial timeout is not `timeout_s` [s] any more.
    """

    def status() -> None:
        health.status = dialogue.status()

    def voltage() -> None:
        health.voltage = dialogue.ask(commands.MAIN_VOLTAGE)[0] / 10

    def currents() -> None:
        first, second = dialogue.ask(commands.CURRENTS)
        health.currents = (first / 100, second / 100)

    def temperature() -> None:
        health.temperature = dialogue.ask(commands.TEMPERATURE)[0] / 10

    def timeout() -> None:
        if not check_timeout(dialogue, timeout_s):
            raise DeviceError(
                "the RoboClaw has lost its serial timeout: it was switched off and on, or another "
                "program sets it"
            )

    return status, voltage, status, currents, status, temperature, status, timeout
