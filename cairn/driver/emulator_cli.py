"""What commands of `cairn emulate` share: options, fault commands on stdin, recordings.

A package adds an emulator of its own as a function for typer, named by an entry point of the group
`cairn.emulators`. Its parameters are annotated with the options here that it has (`Pty`, `Tcp`,
`Serial`, `Record`, `Faults`, `Seed`, `Paced`); it creates the device and calls `emulate`.
"""

from __future__ import annotations

import math
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cairn.driver.emulator import FRAME_FAULTS, EmulatedDevice, Emulator, FrameFault
from cairn.driver.emulator_lines import LineEnd, PtyEnd, SerialEnd, TcpEnd
from cairn.errors import CairnError
from cairn.system.signal_handlers import signal_handlers

Pty = Annotated[
    Path | None,
    typer.Option(metavar="PATH", help="Create a pseudo-terminal, and a link to it at this path."),
]
Tcp = Annotated[
    int | None,
    typer.Option(min=0, max=65535, metavar="PORT", help="Listen on this TCP port; 0: a free one."),
]
Serial = Annotated[
    str | None,
    typer.Option(metavar="PORT", help="Use this real serial port, cabled to another computer."),
]
Record = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write each scan as it is sent, one line of JSON each."),
]
Faults = Annotated[
    str,
    typer.Option(
        metavar="FAULT=SHARE,...",
        help=f"Shares of frames to damage at random: {', '.join(FRAME_FAULTS)}.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Paced = Annotated[
    bool, typer.Option("--paced", help="Send no faster than a serial line of its speed does.")
]

_CHECK_S = 0.5  # how often the device is checked for a failure
_SERIAL_BAUD = 115200  # of a real port, for a device to which speeds do not matter


@dataclass(frozen=True)
class LineOptions:
    """Where an emulated device is plugged in: one of the three."""

    pty: Path | None = None
    tcp: int | None = None
    serial: str | None = None

    def end(self, baud: int | None, data_bits: int = 8) -> LineEnd:
        """Return the device's end of the line; raises `CairnError` unless exactly one is set."""
        chosen = [one for one in (self.pty, self.tcp, self.serial) if one is not None]
        if len(chosen) != 1:
            raise CairnError(
                f"cairn emulate: {len(chosen)} lines are given, not one; give one of --pty PATH, "
                "--tcp PORT, --serial PORT"
            )
        if self.pty is not None:
            return PtyEnd(self.pty)
        if self.tcp is not None:
            return TcpEnd(self.tcp)
        return SerialEnd(str(self.serial), baud or _SERIAL_BAUD, data_bits=data_bits)


@dataclass(frozen=True)
class FaultCommand:
    """A command that an emulator reads from stdin.

    `run` gets the words after the command's name and returns, in a few words, what it did; it runs
    on the device's own thread. It raises `CairnError` for words that it does not understand.
    """

    usage: str
    """Its arguments, as `[SECONDS]`."""
    help: str
    run: Callable[[list[str]], str]


def emulate(
    name: str,
    device: EmulatedDevice,
    line: LineOptions,
    *,
    faults: str = "",
    seed: int = 0,
    paced: bool = False,
    data_bits: int = 8,
    commands: Mapping[str, FaultCommand] | None = None,
) -> None:
    """Emulate a device until SIGINT, SIGTERM, SIGHUP, or the command `quit`.

    Fault commands are read from stdin, one per line, and answered. It also runs with stdin closed.

    Args:
        name: of the device, for the first line of output.
        device: what to emulate.
        line: where it is plugged in.
        faults: shares of frames to damage: `bad_sum=0.01,cut=0.02`.
        seed: of the faults.
        paced: bytes take the time that the line's speed gives them.
        data_bits: of a byte on a real serial line.
        commands: fault commands of this device, by name, beside those of all devices.

    Raises `CairnError` if the line cannot be opened, and whatever fails in the device.
    """
    end = line.end(device.baud(), data_bits)
    shares = fault_shares(faults)
    with (
        _stop_signals() as stopped,
        Emulator(device, end, shares=shares, paced=paced, seed=seed) as emulator,
    ):
        _print(f"{name} is on {end.address}")
        _print("Type fault commands, such as bad_sum 3 or unplug 2; help lists all. Ctrl-C stops.")
        _serve(emulator, FaultConsole(emulator, commands or {}), stopped)


def fault_shares(text: str) -> dict[FrameFault, float]:
    """Parse shares [1] of frames from `bad_sum=0.01,cut=0.02`; raises `CairnError` if invalid."""
    shares: dict[FrameFault, float] = {}
    for part in filter(None, text.split(",")):
        name, _, number = part.partition("=")
        try:
            share = float(number)
        except ValueError:
            share = -1.0
        known = [fault for fault in FRAME_FAULTS if fault == name.strip()]
        if not known or not 0.0 <= share <= 1.0:
            raise CairnError(
                f"--faults {part}: not a fault and a share; write FAULT=SHARE with one of "
                f"{', '.join(FRAME_FAULTS)}, and a share from 0 to 1"
            )
        shares[known[0]] = share
    return shares


@contextmanager
def recording(path: Path | None) -> Iterator[Callable[[str], None]]:
    """Yield a function that appends a line to a file, and flushes it; with None it does nothing.

    Raises `CairnError` if the file cannot be written, at first or later.
    """
    if path is None:
        yield lambda _: None
        return
    try:
        file = path.open("w", encoding="utf-8")
    except OSError as error:
        raise _unwritable(path, error) from error

    def write(line: str) -> None:
        try:
            file.write(line + "\n")
            file.flush()
        except OSError as error:
            raise _unwritable(path, error) from error

    with file:
        yield write


class FaultConsole:
    """Executes fault commands: those of every device, and those of this one."""

    def __init__(self, emulator: Emulator, own: Mapping[str, FaultCommand]) -> None:
        self._emulator = emulator
        self._own = own
        self._common = {fault: self._frame_fault(fault) for fault in FRAME_FAULTS} | {
            "hang": FaultCommand("[SECONDS]", "neither send nor receive; 0 ends it", self._hang),
            "slow": FaultCommand("BAUD", "send no faster [bit/s]; 0 ends it", self._slow),
            "unplug": FaultCommand("[SECONDS]", "vanish, until `plug` or for a time", self._unplug),
            "plug": FaultCommand("", "be plugged in again", self._plug),
            "status": FaultCommand("", "show what was sent and damaged", self._status),
        }

    def execute(self, line: str) -> str:
        """Execute a line; return what was done, or the error."""
        name, *words = line.split()
        if name == "help":
            return self._help()
        try:
            if name in self._common:
                return self._common[name].run(words)
            if name in self._own:
                own = self._own[name]
                return self._emulator.call(lambda: own.run(words))
        except CairnError as error:
            return f"error: {error}"
        return f"error: unknown command {name}; `help` lists all"

    def _help(self) -> str:
        rows = [
            (f"{name} {command.usage}".rstrip(), command.help)
            for name, command in (*self._common.items(), *self._own.items())
        ]
        rows += [("help", "list the commands"), ("quit", "stop the emulator")]
        return "\n".join(f"  {usage:24} {text}" for usage, text in rows)

    def _frame_fault(self, fault: FrameFault) -> FaultCommand:
        text = {
            "bad_sum": "flip a bit in each of the next frames",
            "cut": "leave out a part of each",
            "garbage": "send noise before each",
            "drop": "do not send them",
        }[fault]

        def run(words: list[str]) -> str:
            frames = _whole_number(words, 1.0, "frames")
            self._emulator.inject(fault, frames)
            return f"{fault}: next {frames} frames" if frames != 1 else f"{fault}: next frame"

        return FaultCommand("[FRAMES]", text, run)

    def _hang(self, words: list[str]) -> str:
        seconds = _number(words, math.inf, "seconds")
        self._emulator.hang(seconds)
        if seconds == 0:
            return "works again"
        return "hangs" if math.isinf(seconds) else f"hangs for {seconds:g} s"

    def _slow(self, words: list[str]) -> str:
        baud = _whole_number(words, math.nan, "bit/s")
        self._emulator.slow(baud or None)
        return f"slow: {baud} bit/s" if baud else "as fast as before"

    def _unplug(self, words: list[str]) -> str:
        seconds = _number(words, math.inf, "seconds")
        self._emulator.unplug(seconds)
        return "unplugged" if math.isinf(seconds) else f"unplugged for {seconds:g} s"

    def _plug(self, words: list[str]) -> str:
        _number(words, 0.0, "nothing")
        self._emulator.plug_in()
        return "plugged in"

    def _status(self, words: list[str]) -> str:
        _number(words, 0.0, "nothing")
        emulator = self._emulator
        damaged = ", ".join(f"{fault} {count}" for fault, count in emulator.injected.items())
        return (
            f"{'plugged in' if emulator.plugged_in else 'unplugged'}; received "
            f"{emulator.bytes_received} bytes; sent {emulator.frames_sent} frames; damaged: "
            f"{damaged or 'none'}"
        )


def _whole_number(words: list[str], default: float, what: str) -> int:
    number = _number(words, default, what)
    if not math.isfinite(number):
        raise CairnError(f"{' '.join(words)!r} is not a number of {what}")
    return round(number)


def _number(words: list[str], default: float, what: str) -> float:
    """Parse the one number after a command's name; the default if missing, unless it is NaN."""
    text = " ".join(words)
    try:
        value = float(text) if words else default
    except ValueError:
        value = math.nan
    if not value >= 0:
        raise CairnError(f"{text or 'nothing'!r} is not a number of {what}")
    return value


def _serve(emulator: Emulator, console: FaultConsole, stopped: int) -> None:
    """Execute commands until `quit`, or until a signal makes `stopped` readable."""
    source = None if sys.stdin is None else sys.stdin.fileno()  # closed, as by `<&-`
    rest = b""
    while True:
        emulator.check()
        sources = [stopped] if source is None else [stopped, source]
        ready, _, _ = select.select(sources, [], [], _CHECK_S)
        if stopped in ready:
            return
        if source is None or source not in ready:
            continue
        try:
            data = os.read(source, 4096)
        except OSError:  # a terminal that has gone, or whose foreground is another's
            data = b""
        if not data:
            source = None
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if text == "quit":
                return
            if text:
                _print(console.execute(text))


@contextmanager
def _stop_signals() -> Iterator[int]:
    """Yield a file descriptor that becomes readable when a signal asks for the end."""
    reading, writing = os.pipe()

    def wake(*_: object) -> None:
        os.write(writing, b"!")

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    try:
        # In the background of a terminal, reading its input would stop the process.
        with signal_handlers(numbers, wake), signal_handlers([signal.SIGTTIN], signal.SIG_IGN):
            yield reading
    finally:
        os.close(reading)
        os.close(writing)


def _unwritable(path: Path, error: OSError) -> CairnError:
    return CairnError(
        f"--record {path}: the file cannot be written ({error.strerror}); name another path"
    )


def _print(text: str) -> None:
    typer.echo(text)
    sys.stdout.flush()
