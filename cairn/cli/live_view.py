"""The display of `cairn up` on a terminal: components and log records, redrawn again and again.

In a module of its own because importing `rich` takes 50 ms: only for runs on a terminal.
"""

import time
from collections import deque
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import psutil
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from cairn.runtime.log_output import printable
from cairn.runtime.rosout import render
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.rcl_interfaces import Log
from cairn.system.clock import SECOND

_KEPT = 100  # log records; what fits is shown
_LEAST_LOG_LINES = 6  # of the terminal: components are left out before
_MOST_LINES = 4  # of one warning or error; other records take one line
_MAX_COMPONENTS = 200  # further ones, of forged statuses, are not shown
_PERIOD_S = 0.25
_LOAD_PERIOD_S = 1.0
_STYLES = {"active": "green", "inactive": "yellow", "unconfigured": "yellow", "finalized": "dim"}
_COLUMNS = ("component", "state", "CPU %", "in", "out", "dropped", "restarts", "pid", "handler")
_TEXTS = frozenset({"component", "state", "handler"})
_LEFT_OUT_FIRST = ("handler", "pid", "out", "in")  # if the terminal is too narrow for all
_NOT_LOADED = "not loaded"


class LiveView:
    """The components, the time and the newest log records, in the size of the terminal."""

    def __init__(self, console: Console, title: str, facts: dict[str, str] | None = None) -> None:
        """`facts` are shown below the title, such as the folder of the report."""
        self._console = console
        self._title = title
        self._facts = facts or {}
        self._statuses: dict[str, ComponentStatus] = {}
        self._records: deque[Text] = deque(maxlen=_KEPT)
        self._began = time.monotonic()
        self._drawn = 0.0
        self._now: int | None = None
        self._first: int | None = None
        self._load = _Load()
        self._live = Live(console=console, auto_refresh=False, transient=False)

    def log(self, entry: Log) -> None:
        """Keep the record among the last ones."""
        style = {Log.WARN: "yellow", Log.ERROR: "red", Log.FATAL: "red"}.get(entry.level, "")
        self._records.append(Text(printable(render(entry)), style=style))

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

    def picture(self) -> Group:
        """Return what is drawn: it fits the terminal, with the newest log records at the end."""
        width, height = self._console.size
        head: list[RenderableType] = [self._heading()]
        head += [_fact(*fact, width) for fact in self._facts.items()]
        left = height - 1 - len(head)
        components = self._in_order()
        most = max(1, left - 1 - _LEAST_LOG_LINES)  # below the titles of the table
        shown = components if len(components) <= most else self._chosen(components, most - 1)
        body: list[RenderableType] = [self._table(shown)]
        left -= 1 + len(shown)
        if len(shown) < len(components):
            more = f"and {len(components) - len(shown)} more components: `cairn ps` lists all"
            body.append(Text(more, style="dim", no_wrap=True, overflow="ellipsis"))
            left -= 1
        return Group(*head, *body, *self._newest(width, left))

    def __enter__(self) -> "LiveView":
        self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        """Leave the last picture on the terminal, if it is still there."""
        with suppress(OSError):
            self._draw()
        with suppress(OSError):
            self._live.__exit__(*error)

    def _draw(self) -> None:
        self._drawn = time.monotonic()
        self._live.update(self.picture(), refresh=True)

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

    def _table(self, components: list[tuple[str, int]]) -> Table:
        """Return the table with the columns that fit: a number that is cut off would mislead."""
        self._load.update({status.pid for status in self._statuses.values() if status.pid})
        rows = self._rows(components)
        widths = {
            title: max([len(title), *(row[title].cell_len for row in rows if title in row)])
            for title in _COLUMNS
        }
        widths["handler"] = len("handler")  # the only one that may be cut off
        for title in _LEFT_OUT_FIRST:
            if sum(widths.values()) + 2 * (len(widths) - 1) > self._console.width:
                del widths[title]
        table = Table(box=None, pad_edge=False)
        for title in widths:
            right = title not in _TEXTS
            least = widths[title] if title != "handler" else None
            table.add_column(
                title, justify="right" if right else "left", no_wrap=True, min_width=least
            )
        for row in rows:
            table.add_row(*(row.get(title, "") for title in widths))
        return table

    def _rows(self, components: list[tuple[str, int]]) -> list[dict[str, Text]]:
        """Return what the columns show of components."""
        rows: list[dict[str, Text]] = []
        measured: set[int] = set()  # components in one process share its load
        for name, depth in components:
            label = Text("  " * depth + printable(name))
            status = self._statuses.get(name)
            if status is None:
                label.stylize("dim")
                rows.append({"component": label, "state": Text(_NOT_LOADED, style="dim")})
                continue
            inputs = [port for port in status.ports if port.direction == port.IN]
            outputs = [port for port in status.ports if port.direction == port.OUT]
            dropped = sum(port.dropped for port in inputs)
            load = None if status.pid in measured else self._load.percent.get(status.pid)
            measured.add(status.pid)
            values = (
                label,
                Text(printable(status.state), style=_STYLES.get(status.state, "")),
                Text("" if load is None else f"{load:.0f}"),
                Text(f"{sum(port.messages for port in inputs):,}"),
                Text(f"{sum(port.messages for port in outputs):,}"),
                Text(f"{dropped:,}", style="red" if dropped else ""),
                Text(str(status.restarts)),
                Text(str(status.pid)),
                Text(printable(status.handler)),
            )
            rows.append(dict(zip(_COLUMNS, values, strict=True)))
        return rows

    def _newest(self, width: int, lines: int) -> list[Text]:
        """Return the lines of the newest records, the newest one last."""
        found: list[Text] = []
        for record in reversed(self._records):
            most = min(_MOST_LINES if record.style else 1, lines - len(found))
            if most <= 0:
                break
            wrapped = list(record.wrap(self._console, width, overflow="fold"))
            if len(wrapped) > most:
                del wrapped[most:]
                start = sum(len(line.plain) + 1 for line in wrapped[:-1])
                wrapped[-1] = record[min(start, len(record)) :]
                wrapped[-1].truncate(width, overflow="ellipsis")
            found[:0] = wrapped
        return found

    def _chosen(self, components: list[tuple[str, int]], most: int) -> list[tuple[str, int]]:
        """Return the components that matter most: not those that are not loaded, nor all active."""

        def rank(one: tuple[str, int]) -> int:
            status = self._statuses.get(one[0])
            return 2 if status is None else 1 if status.state == "active" else 0

        kept = sorted(components, key=rank)[:most]
        return [one for one in components if one in kept]

    def _in_order(self) -> list[tuple[str, int]]:
        """Return the components as a tree: each below its supervisor, with its depth."""
        found: dict[str, int] = {}

        def add(name: str, depth: int) -> None:
            if name in found or len(found) >= _MAX_COMPONENTS:
                return
            found[name] = depth
            status = self._statuses.get(name)
            for child in status.children if status is not None else ():
                add(child, depth + 1)

        for name, status in self._statuses.items():
            if not status.parent:
                add(name, 0)
        for name in self._statuses:  # those whose supervisor has sent no status yet
            add(name, 0)
        return list(found.items())


class _Load:
    """The load of processes, measured once a second."""

    def __init__(self) -> None:
        self.percent: dict[int, float] = {}
        """Share of one processor in the last second [%], by process id."""
        self._processes: dict[int, psutil.Process] = {}
        self._measured = 0.0

    def update(self, pids: set[int]) -> None:
        """Measure these processes, if that is due."""
        if time.monotonic() - self._measured < _LOAD_PERIOD_S:
            return
        self._measured = time.monotonic()
        measured: dict[int, float] = {}
        known = self._processes
        self._processes = {}
        for pid in pids:
            with suppress(psutil.Error):  # it has ended, or is of another user
                is_new = pid not in known
                process = self._processes[pid] = known.get(pid) or psutil.Process(pid)
                percent = process.cpu_percent()
                if not is_new:  # the first call only begins a measurement
                    measured[pid] = percent
        self.percent = measured


def _fact(name: str, value: str, width: int) -> Text:
    """Return a line; of a long value, only the end: paths of runs differ there."""
    room = width - len(name) - 1
    shown = value if len(value) <= room else f"…{value[len(value) - room + 1 :]}"
    return Text.assemble((f"{name} ", "dim"), printable(shown), no_wrap=True, overflow="crop")
