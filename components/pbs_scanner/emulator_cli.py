"""`cairn emulate pbs-03jn`: an emulated obstacle scanner."""

from __future__ import annotations

from typing import Annotated

import typer

from cairn.components.pbs_scanner.emulator import EmulatedPbs
from cairn.driver.emulator_cli import (
    Faults,
    LineOptions,
    Paced,
    Pty,
    Record,
    Seed,
    Serial,
    Tcp,
    emulate,
    recording,
)


def pbs_03jn(
    pty: Pty = None,
    tcp: Tcp = None,
    serial: Serial = None,
    record: Record = None,
    low_speed: Annotated[
        bool, typer.Option("--low-speed", help="Turn in 110 ms instead of 100 ms.")
    ] = False,
    faults: Faults = "",
    seed: Seed = 0,
    paced: Paced = False,
) -> None:
    """Emulate a PBS-03JN, which sends 121 distances over a link.

    For example: cairn emulate pbs-03jn --pty /tmp/scanner

    It sends link code, link (three seconds) and distances.
    """
    with recording(record) as write:
        device = EmulatedPbs(
            seed=seed, low_speed=low_speed, on_scan=lambda sent: write(sent.line())
        )
        emulate(
            "a PBS-03JN",
            device,
            LineOptions(pty, tcp, serial),
            faults=faults,
            seed=seed,
            paced=paced,
            data_bits=7,
        )
