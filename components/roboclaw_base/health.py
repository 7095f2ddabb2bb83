"""Health of a RoboClaw: what is read from it between velocity commands, and what is known of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.client import PacketCounts, RoboclawClient, has_timeout
from cairn.components.roboclaw_base.protocol import ControllerStatus
from cairn.driver.errors import DeviceError

NOT_CONNECTED = "it is not connected yet"


@dataclass
class ControllerHealth:
    """What is known of the controller. The drive loop writes it, the component reads it."""

    version: str = ""
    status: ControllerStatus = field(default_factory=ControllerStatus)
    voltage: float = math.nan
    """Main battery [V]."""
    currents: tuple[float, float] = (math.nan, math.nan)
    """Of M1 and M2 [A]."""
    temperature: float = math.nan
    """[deg C]"""
    wheel_fault: str | None = None
    """The fault of a wheel; since then the motors are off."""
    device_error: str | None = NOT_CONNECTED
    """Why there is no connection; None if there is one."""
    awaits_rest: bool = False
    """Whether the command must be rest, or cease, once before the wheels turn again."""
    connections: int = 0
    counts: PacketCounts = field(default_factory=PacketCounts)


class RetryShare:
    """Measures which share of the packets had to be sent again recently."""

    def __init__(self) -> None:
        self._packets = self._retries = 0

    def since_last(self, counts: PacketCounts) -> float:
        """Return the share of retries since the last call [1]."""
        packets, retries = counts.packets - self._packets, counts.retries - self._retries
        self._packets, self._retries = counts.packets, counts.retries
        return retries / packets if packets else 0.0


def health_polls(
    client: RoboclawClient, health: ControllerHealth, timeout_s: float
) -> tuple[Callable[[], None], ...]:
    """Return functions to be called in turn, one per period, that read values into `health`.

    The status is read every other time: it stops the base. They raise `DeviceError`, also if the
    serial timeout is no longer `timeout_s` [s].
    """

    def status() -> None:
        health.status = client.status()

    def voltage() -> None:
        health.voltage = client.read(protocol.MAIN_VOLTAGE)[0] / 10

    def currents() -> None:
        first, second = client.read(protocol.CURRENTS)
        health.currents = (first / 100, second / 100)

    def temperature() -> None:
        health.temperature = client.read(protocol.TEMPERATURE)[0] / 10

    def timeout() -> None:
        if not has_timeout(client, timeout_s):
            raise DeviceError(
                "the RoboClaw has lost its serial timeout: it was switched off and on, or another "
                "program changes it; check its power and close other programs"
            )

    return status, voltage, status, currents, status, temperature, status, timeout
