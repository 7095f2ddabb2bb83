"""`cairn driver`: tries devices without a deployment."""

from __future__ import annotations

import typer

from cairn.cli.installed import installed_commands

PROBES_GROUP = "cairn.probes"
"""Entry points of this group add kinds of devices: each a function as typer takes it."""

app = typer.Typer(help="Try a device without a deployment.", no_args_is_help=True)
app.add_typer(
    installed_commands(PROBES_GROUP, "probe", "Find a device out, and watch what it measures."),
    name="probe",
)
