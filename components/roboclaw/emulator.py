"""An emulated RoboClaw: its packets, its time limits, two motors.

It does what the manual says (see `packets.py`, `commands.py`), and where the manual is silent, what
is the worse for a driver.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from cairn.components.roboclaw.emulated_answers import ANSWERS
from cairn.components.roboclaw.emulated_controller import EmulatedController, Firmware
from cairn.components.roboclaw.emulated_orders import Ordered, orders_of
from cairn.components.roboclaw.packets import (
    ACKNOWLEDGED,
    ADDRESSES,
    PACKET_TIMEOUT_S,
    SUM_SIZE,
    crc16,
    reply_packet,
)

_STEP_S = 0.005
_REMEMBERED = 100_000  # steps of motion


@dataclass(frozen=True)
class Moved:
    """How the motors M1 and M2 truly were at a time [s]: speeds [counts/s], ways [counts]."""

    time: float
    speeds: tuple[float, float]
    turned: tuple[float, float]


class EmulatedRoboclaw:
    """The controller and its motors. An `EmulatedDevice` of `cairn.driver.emulator`.

    Its power comes from the battery: when the line is unplugged it goes on, and its serial timeout
    is what stops the motors.
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
        """`address`: the one that it listens to, None for all, as over USB; `baud` None: any;
        `full_speed`: of both motors at full power [counts/s]; `firmware`: its generation.
        """
        self.controller = EmulatedController(version, full_speed, lag_s, first_counts, firmware)
        self.moved: deque[Moved] = deque(maxlen=_REMEMBERED)
        """What the motors have done, step by step."""
        self.timeouts = 0
        """How often the motors were stopped because nothing came."""
        self.refused = 0
        """Packets thrown away: cut off, of an unknown command, or with a false sum."""
        self._addresses = ADDRESSES if address is None else (address,)
        self._baud = baud
        self._orders = orders_of(firmware)
        self._packet = b""
        self._heard = -math.inf
        self._timed_out = False
        self._now: float | None = None

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take bytes; the replies to the packets that they complete."""
        self.advance(now)
        if self._packet and now - self._heard > PACKET_TIMEOUT_S:
            self._throw_away()
        self._heard, self._timed_out = now, False
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
        """When motors have moved on, or the serial timeout ends."""
        if self._now is None:
            return math.inf
        return math.inf if self.controller.at_rest else self._now + 2.0 * _STEP_S

    def tick(self, now: float) -> list[bytes]:
        """Let time pass; it never says anything of its own accord."""
        self.advance(now)
        return []

    def disconnected(self, now: float) -> None:
        """Take no note: a serial line tells nothing of it."""

    def powered_on(self, now: float) -> None:
        """Begin to live at the first time; afterwards the line comes back, no more."""
        if self._now is None:
            self._now = now
        self.advance(now)
        self._packet = b""

    def baud(self) -> int | None:
        """The speed at which it speaks [bit/s]; None where it does not matter, as over USB."""
        return self._baud

    def advance(self, now: float) -> None:
        """Let time pass until `now` [s]."""
        if self._now is None:
            self._now = now
        while self._now < now:
            if self._silent_too_long(self._now) or self.controller.switched_off:
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
        self.moved.append(Moved(now, (first.speed, second.speed), (first.turned, second.turned)))

    def _silent_too_long(self, now: float) -> bool:
        """Whether the serial timeout has just ended (command 14)."""
        limit = self.controller.timeout_s
        if self._timed_out or not limit or now - self._heard < limit:
            return False
        self._timed_out = True
        self.timeouts += not self.controller.at_rest
        return True

    def _complete(self) -> bytes:
        """The reply, if the packet is complete."""
        if len(self._packet) < 2:
            return b""
        address, command = self._packet[:2]
        if command in ANSWERS:
            self._packet = b""
            return reply_packet(address, command, ANSWERS[command](self.controller))
        if command not in self._orders:
            self._throw_away()
            return b""
        return self._obeyed(self._orders[command])

    def _obeyed(self, ordered: Ordered) -> bytes:
        size = 2 + ordered.layout.size
        if len(self._packet) < size + SUM_SIZE:
            return b""
        packet, sum_ = self._packet[:size], self._packet[size:]
        if crc16(packet).to_bytes(SUM_SIZE, "big") != sum_:
            self._throw_away()
            return b""
        self._packet = b""
        ordered.obey(self.controller, *ordered.layout.unpack(packet[2:]))
        return ACKNOWLEDGED

    def _throw_away(self) -> None:
        self._packet = b""
        self.refused += 1
