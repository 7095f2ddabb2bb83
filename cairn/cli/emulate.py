"""`cairn emulate`: emulators of devices, for trying drivers without hardware."""

from __future__ import annotations

import typer

from cairn.cli.lazy import lazy_group

EMULATORS_GROUP = "cairn.emulators"
"""Entry points of this group add emulators: each a function for typer."""

app = typer.Typer(
    cls=lazy_group(entry_points=EMULATORS_GROUP, kind="emulator"),
    help="Emulate a device on a pseudo-terminal, a TCP port or a serial port, and inject faults.",
    no_args_is_help=True,
)


@app.callback()
def _no_options() -> None:
    """Take no options of its own."""
