"""The output of commands: what peers say cannot control the terminal."""

import io
import sys
from collections.abc import Callable

import pytest
from rich.console import Console

from cairn import CairnError
from cairn.cli.live_view import LiveView
from cairn.cli.main import _print_error
from cairn.cli.up_messages import PlainView
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header
from cairn.terminal.output import line, note, print_json, show

HOSTILE = "base\x1b[2J\x1b]0;title\x07\r\x9b1m\u202e"


@pytest.mark.parametrize("name", ["lines", "notes", "tables", "json", "errors", "records", "live"])
def test_control_characters_of_peers_do_not_reach_the_terminal(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = io.StringIO()
    entry = Log(name="robot.base", msg=HOSTILE)
    if name == "live":
        with LiveView(Console(file=drawn, width=100), "robot") as view:
            view.log(entry)
            view.status(
                ComponentStatus(header=Header(), component=HOSTILE, state="active", handler=HOSTILE)
            )
    else:
        {
            "lines": lambda: line(HOSTILE),
            "notes": lambda: note(HOSTILE),
            "tables": lambda: show([{"component": HOSTILE}], ["component"], as_json=False),
            "json": lambda: print_json({"component": HOSTILE}),
            "errors": lambda: _print_error(str(CairnError(HOSTILE))),
            "records": lambda: PlainView(line).log(entry),
        }[name]()

    output = "".join([*capsys.readouterr(), drawn.getvalue()])
    assert "base" in output
    assert not {"\x1b", "\x07", "\r", "\x9b", "\u202e"} & set(output)


@pytest.mark.parametrize(("show_line", "stream"), [(line, "stdout"), (note, "stderr")])
def test_line_is_written_at_once_so_that_no_other_one_gets_into_it(
    monkeypatch: pytest.MonkeyPatch, show_line: Callable[[str], None], stream: str
) -> None:
    class Stream(io.StringIO):
        def write(self, text: str) -> int:
            writes.append(text)
            return len(text)

    writes: list[str] = []
    monkeypatch.setattr(sys, stream, Stream())

    show_line("the log is incomplete")

    assert writes == ["the log is incomplete\n"]
