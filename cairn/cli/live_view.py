"""The display of `cairn up` on a terminal: a table, redrawn again and again.

In a module of its own because importing `rich` takes 50 ms: only for runs on a terminal.
"""

import time
from collections import deque
from contextlib import suppress
from datetime import UTC, datetime
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from cairn.clock import SECOND
from cairn.runtime.log_output import printable
from cairn.runtime.rosout import render
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.rcl_interfaces import Log

_LINES = 12
_MAX_COMPONENTS = 200  # further ones, of forged statuses, are not shown
_PERIOD_S = 0.25
_STYLES = {"active": "green", "inactive": "yellow", "unconfigured": "yellow", "finalized": "dim"}


class LiveView:
    """A table of the components, the time, and the last log messages."""

    def __init__(self, console: Console, title: str) -> None:
        self._title = title
        self._statuses: dict[str, ComponentStatus] = {}
        self._lines: deque[Text] = deque(maxlen=_LINES)
        self._began = time.monotonic()
        self._drawn = 0.0
        self._now: int | None = None
        self._first: int | None = None
        self._live = Live(console=console, auto_refresh=False, transient=False)

    def log(self, entry: Log) -> None:
        """Keep the message among the last ones."""
        style = {Log.WARN: "yellow", Log.ERROR: "red", Log.FATAL: "red"}.get(entry.level, "")
        self._lines.append(
            Text(printable(render(entry)), style=style, no_wrap=True, overflow="ellipsis")
        )

    def status(self, status: ComponentStatus) -> None:
        """Keep the status for the table."""
        if status.component in self._statuses or len(self._statuses) < _MAX_COMPONENTS:
            self._statuses[status.component] = status

    def time(self, now: int) -> None:
        """Keep the time for the heading."""
        self._now = now
        self._first = now if self._first is None else self._first

    def refresh(self) -> None:
        """Draw, at most four times a second."""
        if time.monotonic() - self._drawn >= _PERIOD_S:
            self._draw()

    def __enter__(self) -> "LiveView":
        self._live.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last picture on the terminal, if it is still there."""
        with suppress(OSError):
            self._draw()
        with suppress(OSError):
            self._live.__exit__(kind, error, trace)

    def _draw(self) -> None:
        self._drawn = time.monotonic()
        self._live.update(Group(self._heading(), self._table(), *self._lines), refresh=True)

    def _heading(self) -> Rule:
        wall = time.monotonic() - self._began
        text = f"{self._title}   {wall:.0f} s"
        if self._now is not None and self._first is not None:
            lived = (self._now - self._first) / SECOND
            clock = datetime.fromtimestamp(self._now / SECOND, UTC).strftime("%H:%M:%S")
            text += f"   time {clock}, {lived:.0f} s passed"
            if wall > 1:
                text += f" ({lived / wall:.1f} times real time)"
        return Rule(Text(text), align="left")

    def _table(self) -> Table:
        table = Table(box=None, pad_edge=False)
        for column in ("component", "state", "handler"):
            table.add_column(column)
        for column in ("messages in", "out", "dropped", "restarts", "pid"):
            table.add_column(column, justify="right")
        for name, depth in self._in_order():
            status = self._statuses[name]
            inputs = [port for port in status.ports if port.direction == port.IN]
            outputs = [port for port in status.ports if port.direction == port.OUT]
            dropped = sum(port.dropped for port in inputs)
            table.add_row(
                Text("  " * depth + printable(name)),
                Text(status.state, style=_STYLES.get(status.state, "")),
                Text(printable(status.handler)),
                f"{sum(port.messages for port in inputs):,}",
                f"{sum(port.messages for port in outputs):,}",
                Text(f"{dropped:,}", style="red" if dropped else ""),
                str(status.restarts),
                str(status.pid),
            )
        return table

    def _in_order(self) -> list[tuple[str, int]]:
        """The components as a tree: each below its supervisor, with its depth."""
        found: list[tuple[str, int]] = []

        def add(parent: str, depth: int) -> None:
            for name, status in self._statuses.items():
                if status.parent == parent and name not in dict(found):
                    found.append((name, depth))
                    add(name, depth + 1)

        add("", 0)
        known = dict(found)
        return found + [(name, 0) for name in self._statuses if name not in known]
