"""The `cairn` command: its subcommands, those of installed packages, and how errors are told."""

import io
import logging
import os
import sys
from importlib.metadata import entry_points, version
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from cairn.cli import check, control, graph, logs, param, plugins, ps, schema, topic, up
from cairn.cli.tables import line
from cairn.errors import CairnError
from cairn.process_exit import end_process

COMMANDS_GROUP = "cairn.commands"
"""Entry points of this group add subcommands: a `typer.Typer`, or a function as typer takes it."""

_HELP = ["-h", "--help"]


def build(asked: str | None = None) -> typer.Typer:
    """The command line, with the installed packages' command of the name asked for, or with all.

    A package's commands may take a second to import: who asks for another need not wait for them.
    """
    app = typer.Typer(
        name="cairn",
        help="Component-based robot middleware over Zenoh, and the navigation built on it.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"max_content_width": 100, "help_option_names": _HELP},
    )
    app.callback()(_options)
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
        if asked not in (None, point.name):
            continue
        try:
            found = point.load()
            if isinstance(found, typer.Typer):
                app.add_typer(found, name=point.name)
            else:
                # Arguments may begin with a minus, as coordinates do.
                app.command(point.name, context_settings={"ignore_unknown_options": True})(found)
        except Exception as error:  # a package's broken command must not take the others along
            _complain(f"command {point.name} ({point.value}) cannot be loaded: {error!r}")
    return app


def _tell_version(asked: bool) -> None:
    if asked:
        line(f"cairn {version('cairn-robotics')}, zenoh {version('eclipse-zenoh')}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_tell_version)
    ] = False,
) -> None:
    """What `cairn` itself takes, before a command."""


def script() -> NoReturn:
    """What the `cairn` program runs: the command, and then the end of its process."""
    try:
        main()
    except SystemExit as end:
        end_process(end.code if isinstance(end.code, int) else int(end.code is not None))
    end_process(0)


def main() -> None:
    """Run the command; an error of ours is a sentence on stderr and exit status 1."""
    _open_missing_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # else a test reads it
            stream.reconfigure(errors="backslashreplace")  # whatever the locale, no run fails so
    logging.captureWarnings(True)
    try:
        _check_folder()
        build(next((word for word in sys.argv[1:] if word not in _HELP), None))()
    except CairnError as error:
        _complain(str(error))
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output, `head` perhaps, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at exit
        sys.exit(1)


def _check_folder() -> None:
    try:
        os.getcwd()
    except OSError as error:
        raise CairnError("the current folder has been removed; change to another one") from error


def _open_missing_streams() -> None:
    """Stand in for standard streams that whoever started us has closed (`cairn up ... >&-`).

    A socket must not get one of their numbers: it would be taken for the stream by a child.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _complain(text: str) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    console.print(f"cairn: {text}", style="red", markup=False)


if __name__ == "__main__":
    script()
