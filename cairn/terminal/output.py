"""The output of commands: lines, tables, JSON, remarks."""

import io
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TextIO

from cairn.errors import CairnError
from cairn.runtime.log_output import printable

_MAX_PROBLEMS = 20
_WIDE = 10_000  # columns, if the output is not a terminal but perhaps `grep`


class OutputLost(CairnError):
    """The output cannot be written: the disk is full, or the terminal was closed."""


def show(
    rows: Sequence[Mapping[str, Any]],
    columns: Mapping[str, str] | Sequence[str],
    *,
    as_json: bool,
    nothing: str = "there is none",
) -> None:
    """Print rows: as JSON with all their keys, or as a table of the given columns.

    `columns` are keys, or keys with their titles; `nothing` is printed for a table without rows.
    """
    if as_json:
        print_json([dict(row) for row in rows])
        return
    if not rows:
        line(nothing)
        return
    from rich.console import Console  # takes 30 ms: not for commands that print lines
    from rich.table import Table
    from rich.text import Text

    titles = columns if isinstance(columns, Mapping) else {column: column for column in columns}
    table = Table(box=None, pad_edge=False, header_style="bold")
    for key, title in titles.items():
        numeric = all(isinstance(row.get(key), int | float | None) for row in rows)
        table.add_column(Text(title), overflow="fold", justify="right" if numeric else "left")
    for row in rows:
        table.add_row(*(Text(_text(row.get(key))) for key in titles))
    if sys.stdout.isatty():
        Console(highlight=False).print(table)
        return
    drawn = io.StringIO()
    Console(file=drawn, width=_WIDE, highlight=False, color_system=None).print(table)
    line("\n".join(text.rstrip() for text in drawn.getvalue().splitlines()))


def print_json(value: Any) -> None:
    """Print a value as indented JSON; errors as `line`."""
    line(json.dumps(value, indent=2, ensure_ascii=False))


def line(text: str) -> None:
    """Print one line, or several, without characters that control a terminal.

    Raises `BrokenPipeError` if the reader has ended, `OutputLost` if the disk is full.
    """
    try:
        _write(sys.stdout, text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputLost(f"the output cannot be written: {error.strerror}") from error


def note(text: str) -> None:
    """Print a remark on stderr, if that can be written."""
    with suppress(OSError):
        _write(sys.stderr, text)


def _write(stream: TextIO, text: str) -> None:
    """Write a line at once: between the two writes of `print`, another thread's line could get in.

    `print` makes two on stderr, and with PYTHONUNBUFFERED on stdout as well.
    """
    stream.write(f"{printable(text)}\n")
    stream.flush()


def print_problems(problems: Iterable[str]) -> None:
    """Print warnings, each once, on stderr."""
    found = list(dict.fromkeys(problems))
    for problem in found[:_MAX_PROBLEMS]:
        note(f"warning: {problem}")
    if len(found) > _MAX_PROBLEMS:
        note(f"{len(found) - _MAX_PROBLEMS} more warnings are left out")


def _text(value: Any) -> str:
    match value:
        case None:
            return ""
        case float():
            return f"{value:.2f}"
        case list() | tuple():
            return ", ".join(_text(item) for item in value)
        case _:
            return printable(str(value))
