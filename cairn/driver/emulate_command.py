"""What commands that emulate a device share: options, where it is plugged in, orders on stdin.

A package's own emulator is a function as typer takes it, which is named by an entry point of the
group `cairn.emulators`; it makes the device and calls `emulate`.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cairn.driver.emulated_lines import LineEnd, PtyEnd, TcpEnd
from cairn.driver.emulated_serial_port import SerialEnd
from cairn.driver.emulation import EmulatedDevice, Emulation
from cairn.driver.emulator_orders import Order, Orders
from cairn.driver.faults import FRAME_FAULTS, FrameFault
from cairn.errors import CairnError

Pty = Annotated[
    Path | None,
    typer.Option(metavar="PATH", help="Be a serial port in software, linked to by this path."),
]
Tcp = Annotated[
    int | None,
    typer.Option(min=0, max=65535, metavar="PORT", help="Be behind this TCP port; 0: a free one."),
]
Serial = Annotated[
    str | None,
    typer.Option(metavar="PORT", help="Be at the other end of this real serial port."),
]
Faults = Annotated[
    str,
    typer.Option(
        metavar="FAULT=SHARE,...",
        help=f"Shares of frames that are spoilt at random: {', '.join(FRAME_FAULTS)}.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Of all that is random.")]
Paced = Annotated[
    bool, typer.Option("--paced", help="Send no faster than a serial line of its speed does.")
]

_CHECK_S = 0.5  # how often it is looked whether the device has failed
_SERIAL_BAUD = 115200  # of a real port, for a device to which speeds do not matter


@dataclass(frozen=True)
class Place:
    """Where an emulated device is plugged in: one of the three."""

    pty: Path | None = None
    tcp: int | None = None
    serial: str | None = None

    def end(self, baud: int | None, data_bits: int = 8) -> LineEnd:
        """The line's end there; raises `CairnError` if none, or more than one, was named."""
        given = [one for one in (self.pty, self.tcp, self.serial) if one is not None]
        if len(given) != 1:
            raise CairnError("say where it is to be: one of --pty PATH, --tcp PORT, --serial PORT")
        if self.pty is not None:
            return PtyEnd(self.pty)
        if self.tcp is not None:
            return TcpEnd(self.tcp)
        return SerialEnd(str(self.serial), baud or _SERIAL_BAUD, data_bits=data_bits)


def emulate(
    name: str,
    device: EmulatedDevice,
    place: Place,
    *,
    faults: str = "",
    seed: int = 0,
    paced: bool = False,
    data_bits: int = 8,
    orders: Mapping[str, Order] | None = None,
) -> None:
    """Emulate a device, called `name`, until SIGINT, SIGTERM, SIGHUP, or the order `quit`.

    Orders are read from stdin, a line each, and answered; without stdin it goes on all the same.
    `data_bits`: of a byte on a real serial line.
    Raises `CairnError` if it cannot be plugged in there, and whatever fails in the device.
    """
    end = place.end(device.baud(), data_bits)
    shares = fault_shares(faults)
    with (
        _stop_signals() as stopped,
        Emulation(device, end, shares=shares, paced=paced, seed=seed) as emulation,
    ):
        _say(f"{name} is on {end.where}")
        _say("Orders, such as bad_sum 3 or unplug 2, are taken from here: help. Ctrl-C ends it.")
        _serve(emulation, Orders(emulation, orders or {}), stopped)


def fault_shares(text: str) -> dict[FrameFault, float]:
    """Shares [1] of frames out of `bad_sum=0.01,cut=0.02`; `CairnError` for what is none."""
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
                f"--faults {part}: write FAULT=SHARE with one of {', '.join(FRAME_FAULTS)}, and a "
                "share from 0 to 1"
            )
        shares[known[0]] = share
    return shares


def _serve(emulation: Emulation, orders: Orders, stopped: int) -> None:
    """Follow orders until one of them, or a signal, ends it."""
    source = None if sys.stdin is None else sys.stdin.fileno()  # closed, as by `<&-`
    held = b""
    while True:
        emulation.check()
        ready, _, _ = select.select([stopped, *_some(source)], [], [], _CHECK_S)
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
        *lines, held = (held + data).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if text == "quit":
                return
            if text:
                _say(orders.answer(text))


def _some(source: int | None) -> list[int]:
    return [] if source is None else [source]


@contextmanager
def _stop_signals() -> Iterator[int]:
    """A file descriptor that becomes readable when a signal asks for the end."""
    reading, writing = os.pipe()

    def ring(*_: object) -> None:
        os.write(writing, b"!")

    asking = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, ring) for number in asking}
    # In the background of a terminal, reading its input would stop the process.
    before[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    try:
        yield reading
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(reading)
        os.close(writing)


def _say(text: str) -> None:
    typer.echo(text)
    sys.stdout.flush()
