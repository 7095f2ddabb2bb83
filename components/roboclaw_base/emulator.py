"""An emulated RoboClaw: its packets, its time limits, two motors.

It follows the manual (see `protocol.py`), and where the manual is silent, it does what is worse for
a driver. Its commands and motors are in `emulator_controller`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from cairn.components.roboclaw_base.emulator_controller import (
    READ_COMMANDS,
    EmulatedController,
    EmulatedWrite,
    Firmware,
    write_commands,
)
from cairn.components.roboclaw_base.protocol import (
    ACKNOWLEDGED,
    ADDRESSES,
    CRC_SIZE,
    PACKET_TIMEOUT_S,
    crc16,
    reply_packet,
)

_STEP_S = 0.005
_RECORDED_STEPS = 100_000


@dataclass(frozen=True)
class TrueMotion:
    """True speeds [counts/s] and distances [counts] of the motors M1 and M2 at a time [s]."""

    time: float
    speeds: tuple[float, float]
    turned: tuple[float, float]


class EmulatedRoboclaw:
    """The controller and its motors. An `EmulatedDevice` of `cairn.driver.emulator`.

    Its power comes from the battery: when the line is unplugged it keeps running until its serial
    timeout stops the motors.
    """

    def __init__(
        self,
        *,
        version: str = "USB Roboclaw 2x7a v4.2.8",
        address: int | None = None,
        baud: int | None = None,
        full_speed: float = 12_000.0,
        lag_s: float = 0.05,
        first_counts: tuple[int, int] = (0, 0),
        firmware: Firmware = "usual",
    ) -> None:
        """Create a controller that is not powered on yet.

        Args:
            version: the reply to the command that reads the version.
            address: the address that it answers to; None for all, as over USB.
            baud: speed of the line [bit/s]; None for any, as over USB.
            full_speed: of both motors at full power [counts/s].
            lag_s: time constant of the motors [s].
            first_counts: the encoders' counters at power-on.
            firmware: its generation.
        """
        self.controller = EmulatedController(version, full_speed, lag_s, first_counts, firmware)
        self.motions: deque[TrueMotion] = deque(maxlen=_RECORDED_STEPS)
        """The motion of the motors, step by step."""
        self.timeouts = 0
        """How often the serial timeout stopped the motors."""
        self.rejected = 0
        """Packets discarded: incomplete, of an unknown command, or with a wrong CRC."""
        self._addresses = ADDRESSES if address is None else (address,)
        self._baud = baud
        self._write_commands = write_commands(firmware)
        self._packet = b""
        self._last_byte_at = -math.inf
        self._timed_out = False
        self._now: float | None = None

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Receive bytes; return the replies to the packets that they complete."""
        self.advance(now)
        if self._packet and now - self._last_byte_at > PACKET_TIMEOUT_S:
            self._discard()
        self._last_byte_at, self._timed_out = now, False
        replies = []
        for byte in data:
            if not self._packet and byte not in self._addresses:
                continue
            self._packet += bytes((byte,))
            reply = self._complete()
            if reply:
                replies.append(reply)
        return replies

    def due(self) -> float:
        """Return when `tick` is due: motors have moved on, or the serial timeout expires."""
        if self._now is None:
            return math.inf
        return math.inf if self.controller.at_rest else self._now + 2.0 * _STEP_S

    def tick(self, now: float) -> list[bytes]:
        """Let time pass; it sends nothing by itself."""
        self.advance(now)
        return []

    def disconnected(self, now: float) -> None:
        """Do nothing: a serial line does not show it."""

    def powered_on(self, now: float) -> None:
        """Start at the first call; afterwards only the line has come back."""
        if self._now is None:
            self._now = now
        self.advance(now)
        self._packet = b""

    def baud(self) -> int | None:
        """Return the speed of its line [bit/s]; None where it does not matter, as over USB."""
        return self._baud

    def advance(self, now: float) -> None:
        """Let time pass until `now` [s]."""
        if self._now is None:
            self._now = now
        while self._now < now:
            if self._timeout_expired(self._now) or self.controller.switched_off:
                self.controller.switch_off()
            if self.controller.at_rest:
                self._now = now
                return
            until = min(now, self._now + _STEP_S)
            self._move(until, until - self._now)
            self._now = until

    def _move(self, now: float, seconds: float) -> None:
        first, second = self.controller.motors
        for motor in (first, second):
            motor.step(seconds)
        self.motions.append(
            TrueMotion(now, (first.speed, second.speed), (first.turned, second.turned))
        )

    def _timeout_expired(self, now: float) -> bool:
        """Return whether the serial timeout has just expired (command 14)."""
        limit = self.controller.timeout_s
        if self._timed_out or not limit or now - self._last_byte_at < limit:
            return False
        self._timed_out = True
        self.timeouts += not self.controller.at_rest
        return True

    def _complete(self) -> bytes:
        """Return the reply if the packet is complete, else nothing."""
        if len(self._packet) < 2:
            return b""
        address, command = self._packet[:2]
        if command in READ_COMMANDS:
            self._packet = b""
            return reply_packet(address, command, READ_COMMANDS[command](self.controller))
        if command not in self._write_commands:
            self._discard()
            return b""
        return self._executed(self._write_commands[command])

    def _executed(self, command: EmulatedWrite) -> bytes:
        size = 2 + command.layout.size
        if len(self._packet) < size + CRC_SIZE:
            return b""
        packet, crc = self._packet[:size], self._packet[size:]
        if crc16(packet).to_bytes(CRC_SIZE, "big") != crc:
            self._discard()
            return b""
        self._packet = b""
        command.execute(self.controller, *command.layout.unpack(packet[2:]))
        return ACKNOWLEDGED

    def _discard(self) -> None:
        self._packet = b""
        self.rejected += 1
