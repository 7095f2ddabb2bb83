"""The `cairn` command: its subcommands, those of installed packages, and how errors are told."""

import logging
import os
import sys
from importlib.metadata import entry_points

import typer
from rich.console import Console

from cairn.cli import check, control, graph, logs, param, plugins, ps, schema, topic, up
from cairn.errors import CairnError

COMMANDS_GROUP = "cairn.commands"
"""Entry points of this group add subcommands: each names a `typer.Typer`."""


def build() -> typer.Typer:
    """The whole command line, commands of installed packages included."""
    app = typer.Typer(
        name="cairn",
        help="Component-based robot middleware over Zenoh, and the navigation built on it.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"max_content_width": 100, "help_option_names": ["-h", "--help"]},
    )
    app.command("up")(up.up)
    app.command("check")(check.check)
    app.command("ps")(ps.ps)
    app.command("graph")(graph.graph)
    app.command("plugins")(plugins.plugins)
    app.command("load")(control.load)
    app.command("unload")(control.unload)
    app.command("restart")(control.restart)
    app.command("logs")(logs.logs)
    app.add_typer(topic.app, name="topic")
    app.add_typer(param.app, name="param")
    app.add_typer(schema.app, name="schema")
    for point in sorted(entry_points(group=COMMANDS_GROUP), key=lambda point: point.name):
        try:
            app.add_typer(point.load(), name=point.name)
        except Exception as error:  # a package's broken command must not take the others along
            _complain(f"command {point.name} ({point.value}) cannot be loaded: {error!r}")
    return app


def main() -> None:
    """Run the command; an error of ours is a sentence on stderr and exit status 1."""
    _open_missing_streams()
    logging.captureWarnings(True)
    try:
        build()()
    except CairnError as error:
        _complain(str(error))
        sys.exit(1)
    except BrokenPipeError:  # the reader of our output, `head` perhaps, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at exit
        sys.exit(1)


def _open_missing_streams() -> None:
    """Stand in for standard streams that whoever started us has closed (`cairn up ... >&-`).

    A socket must not get one of their numbers: it would be taken for the stream by a child.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _complain(text: str) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"cairn: {text}", style="red", markup=False)


if __name__ == "__main__":
    main()
