"""An emulated Lantern, in a known room."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import PtyEnd

from lantern_driver import protocol
from lantern_driver.protocol import Turn, write_turn

SURROUNDINGS = {math.radians(90): 1.0, 0.0: 2.0, math.radians(-90): 3.0}
"""Ranges [m] of the walls around it, by bearing [rad, left positive]."""

_PERIOD_S = 1.0 / protocol.RATE_HZ


class EmulatedLantern:
    """The behavior of the device on its line; `cairn.driver.emulator` runs it."""

    def __init__(self) -> None:
        self._due = math.inf
        self._turns = 0

    def receive(self, data: bytes, now: float) -> list[bytes]:
        if protocol.START in data:
            self._due = now + _PERIOD_S
        if protocol.STOP in data:
            self._due = math.inf
        return []

    def due(self) -> float:
        return self._due

    def tick(self, now: float) -> list[bytes]:
        if now < self._due:
            return []
        ended, self._due = self._due, self._due + _PERIOD_S
        return [write_turn(Turn(round(ended * 1000) % (1 << 16), self._distances()))]

    def disconnected(self, now: float) -> None:
        """Do nothing: a line with three wires does not show it."""

    def powered_on(self, now: float) -> None:
        self._due = math.inf

    def baud(self) -> int:
        return protocol.BAUD

    def _distances(self) -> tuple[int, ...]:
        """Return a wall from 1 m on the left to 3 m on the right, with noise and two gaps [mm]."""
        self._turns += 1
        walls = [1000 + 2000 * beam // (protocol.BEAMS - 1) for beam in range(protocol.BEAMS)]
        noise = [(7 * beam + 5 * self._turns) % 11 - 5 for beam in range(protocol.BEAMS)]
        distances = [wall + off for wall, off in zip(walls, noise, strict=True)]
        distances[20] = distances[70] = 0
        return tuple(distances)


class Lantern:
    """The device as the contracts use it: its address, and how to unplug it."""

    def __init__(self, path: Path) -> None:
        self.emulator = Emulator(EmulatedLantern(), PtyEnd(path))
        self._path = path

    @property
    def settings(self) -> Mapping[str, str]:
        return {"port": str(self._path)}

    def unplug(self) -> None:
        self.emulator.unplug()

    def plug_in(self) -> None:
        self.emulator.plug_in()


@contextmanager
def plugged_in(folder: Path) -> Iterator[Lantern]:
    """Provide an emulated Lantern for the duration of the context."""
    lantern = Lantern(folder / "lantern")
    with lantern.emulator:
        yield lantern
