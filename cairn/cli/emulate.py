"""`cairn emulate`: devices in software, for trying drivers without hardware."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

import typer

from cairn.errors import CairnError

EMULATORS_GROUP = "cairn.emulators"
"""Entry points of this group add devices: each a function as typer takes it."""


def build() -> typer.Typer:
    """The command with the emulators of all installed packages; one that is broken says so."""
    app = typer.Typer(
        help="Emulate a device on a serial port in software, or a TCP port, with faults to order.",
        no_args_is_help=True,
        rich_markup_mode=None,
    )
    for point in sorted(entry_points(group=EMULATORS_GROUP), key=lambda point: point.name):
        try:
            app.command(point.name)(point.load())
        except Exception as error:  # a package's broken emulator must not take the others along
            refusal = f"emulator {point.name} ({point.value}) cannot be loaded: {error!r}"
            app.command(point.name, help=refusal)(_refusing(refusal))
    app.callback()(_nothing_in_common)
    return app


def _refusing(refusal: str) -> Callable[[], None]:
    def refuse() -> None:
        raise CairnError(refusal)

    return refuse


def _nothing_in_common() -> None:
    """Emulate a device on a serial port in software, or a TCP port, with faults to order."""


app = build()
