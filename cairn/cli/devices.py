"""`cairn driver` and `cairn emulate`: try a device, or a driver, without a deployment."""

from __future__ import annotations

import typer

from cairn.cli.lazy import lazy_group

PROBES_GROUP = "cairn.probes"
"""Entry points of this group add kinds of devices: each a function as typer takes it."""

EMULATORS_GROUP = "cairn.emulators"
"""Entry points of this group add emulators: each a function as typer takes it."""

driver = typer.Typer(help="Try a device without a deployment.", no_args_is_help=True)
_probe = typer.Typer(
    cls=lazy_group(entry_points=PROBES_GROUP, kind="probe"),
    help="Identify a device, and print what it measures.",
    no_args_is_help=True,
)
emulate = typer.Typer(
    cls=lazy_group(entry_points=EMULATORS_GROUP, kind="emulator"),
    help="Emulate a device on a serial port in software, or on a TCP port, with faults on request.",
    no_args_is_help=True,
)


@_probe.callback()
@driver.callback()
@emulate.callback()
def _no_options() -> None:
    """Take no options of its own."""


driver.add_typer(_probe, name="probe")
