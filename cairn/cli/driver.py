"""`cairn driver`: tries devices without a deployment."""

from __future__ import annotations

import typer

from cairn.cli.lazy import lazy_group

PROBES_GROUP = "cairn.probes"
"""Entry points of this group add kinds of devices: each a function as typer takes it."""

app = typer.Typer(help="Try a device without a deployment.", no_args_is_help=True)
_probe = typer.Typer(
    cls=lazy_group(entry_points=PROBES_GROUP, kind="probe"),
    help="Identify a device, and print what it measures.",
    no_args_is_help=True,
)


@_probe.callback()
@app.callback()
def _no_options() -> None:
    """Take no options of its own."""


app.add_typer(_probe, name="probe")
