"""`cairn emulate`: devices in software, for trying drivers without hardware."""

from __future__ import annotations

import typer

from cairn.cli.lazy import lazy_group

EMULATORS_GROUP = "cairn.emulators"
"""Entry points of this group add devices: each a function as typer takes it."""

app = typer.Typer(
    cls=lazy_group(entry_points=EMULATORS_GROUP, kind="emulator"),
    help="Emulate a device on a serial port in software, or on a TCP port, with faults on request.",
    no_args_is_help=True,
)


@app.callback()
def _no_options() -> None:
    """Take no options of its own."""
