"""`cairn emulate hokuyo`: an emulated scanner that speaks SCIP."""

from __future__ import annotations

from typing import Annotated

import typer

from cairn import CairnError
from cairn.components.hokuyo_scanner.emulator import RS232_BAUDS, EmulatedScip
from cairn.components.hokuyo_scanner.emulator_models import MODELS
from cairn.driver.emulator_cli import (
    FaultCommand,
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

_MODEL_HELP = f"Its model: {', '.join(MODELS)}."


def hokuyo(
    model: Annotated[str, typer.Option(help=_MODEL_HELP)] = "UTM-30LX",
    pty: Pty = None,
    tcp: Tcp = None,
    serial: Serial = None,
    record: Record = None,
    rs232: Annotated[
        int | None,
        typer.Option(metavar="BAUD", help="Use RS-232, at this speed after power-on [bit/s]."),
    ] = None,
    scip1: Annotated[
        bool, typer.Option("--scip1", help="Use SCIP 1.1 after power-on; URG-04LX only.")
    ] = False,
    clock_start: Annotated[
        int,
        typer.Option(metavar="MS", min=0, max=(1 << 24) - 1, help="Its clock at power-on [ms]."),
    ] = 0,
    drift: Annotated[
        float, typer.Option(metavar="PPM", help="By how much its clock goes too fast [1e-6].")
    ] = 0.0,
    odd_sums: Annotated[
        bool,
        typer.Option("--odd-sums", help="Leave `<-...` out of II's sums, as some UTM-30LX do."),
    ] = False,
    serial_number: Annotated[str, typer.Option(help="Its serial number.")] = "H0614967",
    faults: Faults = "",
    seed: Seed = 0,
    paced: Paced = False,
) -> None:
    """Emulate a range scanner that speaks SCIP (URG, UHG, UTM, UST), in a room.

    For example: cairn emulate hokuyo --model UTM-30LX --pty /tmp/scanner

    The room is 6 m by 4 m, with a walking person. Each model has its SCIP 2 commands, and a clock
    of 24 bits of milliseconds: `--clock-start 16770000` wraps around after seven seconds. With
    --rs232, a client at another speed receives noise. On USB and RS-232 the stream continues when
    the client ends; on Ethernet it ends with the connection.
    """
    if model not in MODELS:
        raise CairnError(f"--model {model}: unknown model; give one of {', '.join(MODELS)}")
    known = MODELS[model]
    if scip1 and not known.speaks_scip1:
        raise CairnError(f"--scip1: a {model} has SCIP 2 only; leave this out")
    if rs232 is not None and (rs232 not in RS232_BAUDS or not known.has_rs232):
        raise CairnError(
            f"--rs232 {rs232}: a {model} has no RS-232 line; leave --rs232 out"
            if not known.has_rs232
            else f"--rs232 {rs232}: unknown speed; give one of {', '.join(map(str, RS232_BAUDS))}"
        )
    with recording(record) as write:
        device = EmulatedScip(
            model,
            seed=seed,
            rs232_baud=rs232,
            speaks_scip1=scip1,
            clock_start_ms=clock_start,
            drift_ppm=drift,
            sums_arrows=not odd_sums,
            serial_number=serial_number,
            on_scan=None if record is None else lambda scan: write(scan.line()),
        )
        commands = {
            "scan_status": FaultCommand(
                "STATUS [SCANS]",
                "send this status instead of the next scans: 0M unstable, 21 to 49 stopped, 98 "
                "resumed, 50 to 97 defect",
                lambda words: _send_status(device, words),
            )
        }
        emulate(
            f"a {model}",
            device,
            LineOptions(pty, tcp, serial),
            faults=faults,
            seed=seed,
            paced=paced,
            commands=commands,
        )


def _send_status(device: EmulatedScip, words: list[str]) -> str:
    status, *rest = words or [""]
    count = rest[0] if rest else "1"
    if len(status) != 2 or not (status.isascii() and status.isalnum() and count.isdigit()):
        raise CairnError("write scan_status STATUS [SCANS] with a status of two characters")
    device.send_status(status.upper(), int(count))
    return f"status {status.upper()} instead of the next {count} scans"
