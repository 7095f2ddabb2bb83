"""Commands that consist of what installed packages add to them, found by entry points."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

import typer

from cairn.errors import CairnError


def installed_commands(group: str, kind: str, about: str) -> typer.Typer:
    """A command with a subcommand for each entry point of a group: functions as typer takes them.

    `kind` is what one of them is called in errors: one that is broken must not take the others
    along, and says so when it is asked for. `about` is the command's help.
    """
    app = typer.Typer(help=about, no_args_is_help=True, rich_markup_mode=None)
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        try:
            app.command(point.name)(point.load())
        except Exception as error:
            refusal = f"{kind} {point.name} ({point.value}) cannot be loaded: {error!r}"
            app.command(point.name, help=refusal)(_refusing(refusal))
    app.callback()(_nothing_in_common)  # else a single one would take the command's own place
    return app


def _refusing(refusal: str) -> Callable[[], None]:
    def refuse() -> None:
        raise CairnError(refusal)

    return refuse


def _nothing_in_common() -> None:
    """What all of them take: nothing."""
