"""Orders in words to an emulated device while it runs: faults, unplugging, how it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cairn.driver.emulation import Emulation
from cairn.driver.faults import FRAME_FAULTS, FrameFault
from cairn.errors import CairnError


@dataclass(frozen=True)
class Order:
    """One order: what it takes, what it does.

    `run` is given the words after its name and tells, in a few words, what has been done; it runs
    on the device's own thread. It raises `CairnError` for words that it does not understand.
    """

    takes: str
    does: str
    run: Callable[[list[str]], str]


class Orders:
    """Carries out lines of words: those for every device, and those of this one."""

    def __init__(self, emulation: Emulation, own: Mapping[str, Order]) -> None:
        self._emulation = emulation
        self._own = own
        self._common: dict[str, Order] = {fault: self._spoiling(fault) for fault in FRAME_FAULTS}
        self._common |= {
            "hang": Order("[SECONDS]", "be silent and deaf; 0 ends it", self._hang),
            "slow": Order("BAUD", "send no faster [bit/s]; 0 ends it", self._slow),
            "unplug": Order("[SECONDS]", "be gone; for so long, or until `plug`", self._unplug),
            "plug": Order("", "be plugged in again", self._plug),
            "status": Order("", "tell what has been sent and spoilt", self._status),
        }

    def answer(self, line: str) -> str:
        """Do what a line says, and tell so; what cannot be done is told, too."""
        name, *words = line.split()
        if name == "help":
            return self._help()
        try:
            if name in self._common:
                return self._common[name].run(words)
            if name in self._own:
                own = self._own[name]
                return self._emulation.ask(lambda: own.run(words))
        except CairnError as error:
            return f"not done: {error}"
        return f"not done: there is no order {name}; help lists all"

    def _help(self) -> str:
        rows = [
            (f"{name} {order.takes}".rstrip(), order.does)
            for name, order in (*self._common.items(), *self._own.items())
        ]
        rows += [("help", "tell this"), ("quit", "end")]
        return "\n".join(f"  {usage:24} {does}" for usage, does in rows)

    def _spoiling(self, fault: FrameFault) -> Order:
        does = {
            "bad_sum": "change a bit in each of the next frames",
            "cut": "leave out a part of each",
            "garbage": "send noise before each",
            "drop": "do not send them",
        }[fault]

        def run(words: list[str]) -> str:
            frames = _whole_number(words, 1.0, "frames")
            self._emulation.spoil(fault, frames)
            return f"{fault}: the next {frames}" if frames != 1 else f"{fault}: the next one"

        return Order("[FRAMES]", does, run)

    def _hang(self, words: list[str]) -> str:
        seconds = _number(words, math.inf, "seconds")
        self._emulation.hang(seconds)
        if seconds == 0:
            return "it works again"
        return "it hangs" if math.isinf(seconds) else f"it hangs for {seconds:g} s"

    def _slow(self, words: list[str]) -> str:
        baud = _whole_number(words, math.nan, "bit/s")
        self._emulation.slow(baud or None)
        return f"slow: {baud} bit/s" if baud else "as fast as before"

    def _unplug(self, words: list[str]) -> str:
        seconds = _number(words, math.inf, "seconds")
        self._emulation.unplug(seconds)
        return "unplugged" if math.isinf(seconds) else f"unplugged for {seconds:g} s"

    def _plug(self, words: list[str]) -> str:
        _number(words, 0.0, "nothing")
        self._emulation.plug_in()
        return "plugged in"

    def _status(self, words: list[str]) -> str:
        _number(words, 0.0, "nothing")
        emulation = self._emulation
        spoilt = ", ".join(f"{fault} {count}" for fault, count in emulation.spoilt.items())
        return (
            f"{'plugged in' if emulation.plugged_in else 'unplugged'}; heard "
            f"{emulation.bytes_heard} bytes; sent {emulation.frames_sent} frames, of which were "
            f"spoilt: {spoilt or 'none'}"
        )


def _whole_number(words: list[str], default: float, what: str) -> int:
    number = _number(words, default, what)
    if not math.isfinite(number):
        raise CairnError(f"{' '.join(words)!r} is no number of {what}")
    return round(number)


def _number(words: list[str], default: float, what: str) -> float:
    """The one number that may stand behind an order; not given, the default, unless that is NaN."""
    text = " ".join(words)
    try:
        value = float(text) if words else default
    except ValueError:
        value = math.nan
    if not value >= 0:
        raise CairnError(f"{text or 'nothing'!r} is no number of {what}")
    return value
