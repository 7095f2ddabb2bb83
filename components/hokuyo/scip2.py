"""A sensor that speaks SCIP 2.0, 2.1 or 2.2."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from cairn.components.hokuyo.device_facts import Measuring, keyed, measuring
from cairn.components.hokuyo.dialogue import TRIES, Arrival, Dialogue
from cairn.components.hokuyo.replies import Reply
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scip_text import ScipError, checked, decode_number
from cairn.driver.errors import DeviceError

T = TypeVar("T")

_DAMAGED = 3  # answers in a row, and a line is of no use
_TIME_SAMPLES = 10
_SPEED_SET_S = 0.15
_LASER_OFF = "10"


class Refused(DeviceError):  # noqa: N818 - it tells what happened
    """A sensor has refused a command; `code` says why."""

    def __init__(self, message: str, code: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class ClockReading:
    """The sensor's clock [ms], read at some time between two [ns of the monotonic clock]."""

    time_ms: int
    asked: int
    answered: int


class Scip2:
    """Talks with a sensor that was greeted; see `greeting`."""

    def __init__(self, dialogue: Dialogue) -> None:
        """Ask how it measures; raises `DeviceError` if that cannot be understood."""
        self._dialogue = dialogue
        self._name = dialogue.link.name
        try:
            self.measuring: Measuring = measuring(self._facts("PP"))
        except ScipError as error:
            raise DeviceError(f"{self._name}: {error}") from error

    def version(self) -> Mapping[str, str]:
        """Who made it: VEND, PROD, FIRM, PROT, SERI."""
        return self._facts("VV", tries=1)

    def state(self) -> Mapping[str, str]:
        """How it is: LASR, SCSP, MESM, SBPS, TIME, STAT ..., as it calls these."""
        return self._facts("II", tries=1)

    def set_speed(self, baud: int) -> None:
        """Have it speak at this speed [bit/s] from now on; raises `Refused`, `DeviceError`."""
        code, _ = self._answer(f"SS{baud:06d}")
        if code not in ("00", "03"):
            raise Refused(f"{self._name}: the sensor refuses {baud} bit/s (status {code})", code)
        self._dialogue.set_baud(baud)
        self._dialogue.quieten(_SPEED_SET_S, _SPEED_SET_S)

    def read_clock(self) -> list[ClockReading]:
        """Readings of its clock, its laser off meanwhile; none if it has no such mode."""
        readings: list[ClockReading] = []
        code, _ = self._answer("TM0", tries=1)
        if code not in ("00", "02"):
            return readings
        for _ in range(_TIME_SAMPLES):
            asked = time.monotonic_ns()
            self._dialogue.send("TM1")
            reply = self._dialogue.find("TM1")
            answered = time.monotonic_ns()
            try:
                if reply is not None and reply.code() == "00":
                    told = decode_number(checked(reply.body))
                    readings.append(ClockReading(told, asked, answered))
            except ScipError:
                continue  # damaged on its way: one of ten
        self._answer("TM2")
        return readings

    def start(self, request: ScanRequest) -> None:
        """Switch the laser on and begin a stream; raises `Refused` if it cannot measure so."""
        self._dialogue.forget()
        command = request.command.decode("ascii")
        code, _ = self._answer(command)
        if code == _LASER_OFF:  # there are some that do not switch it on by themselves
            self._answer("BM")
            code, _ = self._answer(command)
        if code not in ("00", "99"):  # 99: the answer was lost, and this is a scan
            raise Refused(f"{self._name}: the sensor refuses {command} (status {code})", code)

    def arrivals(self, limit_s: float) -> list[Arrival]:
        """What has come, waiting up to `limit_s` [s]."""
        return self._dialogue.arrivals(limit_s)

    def stop(self) -> None:
        """End the stream and switch the laser off."""
        self._answer("QT")
        self._dialogue.forget()

    def _facts(self, command: str, *, tries: int = TRIES) -> Mapping[str, str]:
        def read(reply: Reply) -> Mapping[str, str]:
            if reply.code() != "00":
                raise ScipError(f"its status is {reply.code()}")
            return keyed(reply.lines)

        return self._understood(command, read, tries)

    def _answer(self, command: str, *, tries: int = TRIES) -> tuple[str, list[bytes]]:
        """The status with which a command is answered, and the lines that follow."""
        return self._understood(command, lambda reply: (reply.code(), reply.lines), tries)

    def _understood(self, command: str, read: Callable[[Reply], T], tries: int) -> T:
        """What `read` makes of a command's answer, asked for anew if it comes damaged.

        One that does not come at all is awaited `tries` times.
        """
        for _ in range(_DAMAGED - 1):
            with suppress(ScipError):
                return read(self._dialogue.ask(command, tries))
        try:
            return read(self._dialogue.ask(command, tries))
        except ScipError as error:
            raise DeviceError(
                f"{self._name}: the answer to {command} cannot be understood: {error}"
            ) from error
