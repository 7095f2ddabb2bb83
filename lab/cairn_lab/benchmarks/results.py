"""The results file: what was measured, when and where; and the tables of the page that show it."""

import datetime
import math
import os
import platform
import re
import subprocess
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, FiniteFloat

from cairn.system.files import replace_file
from cairn_lab.benchmarks.result import Metric

RESULTS = Path(__file__).parents[2] / "results.json"
MARKED = re.compile(
    r"(?P<begin><!-- (?P<what>results: .+?|measured) -->\n)(.*?)(?P<end><!-- end -->)", re.S
)

SHOWN = 3
"""So many figures of each run are on the page, and all that miss their limit."""


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Figure(_Part):
    """A measured value; a text sums up several runs, such as "1.20 to 1.55"."""

    name: str
    value: FiniteFloat | str
    unit: str = ""
    limit: str = ""
    missed: bool = False
    note: str = ""

    @classmethod
    def of(cls, metric: Metric) -> Self:
        value = float(f"{metric.value:.6g}")
        return cls(
            name=metric.name,
            value=value if math.isfinite(value) else str(value),
            unit=metric.unit,
            limit=metric.limit,
            missed=not metric.kept,
            note=metric.note,
        )

    @property
    def text(self) -> str:
        """The value with its unit."""
        if isinstance(self.value, str):
            value = self.value
        else:
            value = f"{self.value:.3g}" if abs(self.value) < 1000 else f"{self.value:,.0f}"
        return f"{value} {self.unit}".rstrip()


class Machine(_Part):
    """The computer and the versions that influence a measurement."""

    cores: int
    processor: str
    python: str
    zenoh: str

    @classmethod
    def here(cls) -> Self:
        cpuinfo = Path("/proc/cpuinfo")
        found = re.search(r"^model name\s*: (.+)$", cpuinfo.read_text(), re.M)
        return cls(
            cores=len(os.sched_getaffinity(0)),
            processor=found[1] if found else platform.machine(),
            python=platform.python_version(),
            zenoh=version("eclipse-zenoh"),
        )

    def __str__(self) -> str:
        return f"{self.cores} cores, {self.processor}, Python {self.python}, zenoh {self.zenoh}"


class Run(_Part):
    """The figures of one benchmark, or of another command.

    `date` is missing in figures that were copied from an earlier page: they are of several runs at
    `commit` or before.
    """

    date: str | None = None
    commit: str
    machine: Machine
    figures: tuple[Figure, ...]

    @classmethod
    def now(cls, metrics: Sequence[Metric]) -> Self:
        return cls(
            date=datetime.datetime.now(datetime.UTC).date().isoformat(),
            commit=commit(),
            machine=Machine.here(),
            figures=tuple(Figure.of(metric) for metric in metrics),
        )

    @property
    def source(self) -> str:
        """When and where the figures were measured, as a row of a table."""
        when = self.date or "earlier, written by hand"
        return f"{when}|`{self.commit}`|{self.machine}"


class Results(_Part):
    """The newest run of each benchmark, by its name, and of each other command."""

    version: Literal[1]
    runs: dict[str, Run]

    @classmethod
    def read(cls, path: Path) -> Self:
        if not path.exists():
            return cls(version=1, runs={})
        return cls.model_validate_json(path.read_bytes())

    def write(self, path: Path) -> None:
        text = self.model_dump_json(indent=1, exclude_defaults=True) + "\n"
        replace_file(path, text.encode())

    def page(self, page: str) -> str:
        """Return the page with new tables between its markers.

        `<!-- results: startup, make demo -->` begins a table of these runs, `<!-- measured -->` one
        of when and where all were made; `<!-- end -->` ends both. Runs without results are skipped.
        """
        return MARKED.sub(
            lambda found: f"{found['begin']}\n{self._table(found['what'])}\n{found['end']}", page
        )

    def _table(self, what: str) -> str:
        names = what.removeprefix("results: ").split(", ")
        rows = self._sources() if what == "measured" else self._figures(names)
        return "".join(f"|{row}|\n" for row in rows)

    def _figures(self, names: Sequence[str]) -> Iterator[str]:
        yield "command|measurement|result|limit"
        yield "---|---|---|---"
        for name in names:
            command = f"`{name}`"
            figures = self.runs[name].figures if name in self.runs else ()
            for number, figure in enumerate(figures):
                if number < SHOWN or figure.missed:
                    text = re.sub(r"(?<=\d) to (?=\d)", "\N{EN DASH}", figure.text)
                    value = f"**{text}**" if figure.missed else text
                    limit = figure.limit.replace("<= ", "≤").replace(">= ", "≥")
                    yield f"{command}|{figure.name}|{value}|{limit}"
                    command = ""

    def _sources(self) -> Iterator[str]:
        yield "measured|commit|machine|commands"
        yield "---|---|---|---"
        for source in sorted({run.source for run in self.runs.values()}, reverse=True):
            names = [f"`{name}`" for name, run in self.runs.items() if run.source == source]
            few = len(names) <= len(self.runs) / 2
            yield f"{source}|{', '.join(names) if few else 'all not named here'}"


def record(path: Path, name: str, run: Run) -> None:
    """Replace the entry of a benchmark in the results file."""
    results = Results.read(path)
    Results(version=1, runs={**results.runs, name: run}).write(path)


def commit() -> str:
    """Return the commit of the working copy, "+" if it has changes beside results and page."""

    def git(*words: str) -> str:
        folder = Path(__file__).parent
        return subprocess.run(
            ["git", *words], cwd=folder, check=True, capture_output=True, text=True
        ).stdout.strip()

    others = (":(exclude,top)lab/results.json", ":(exclude,top)docs/benchmarks.md")
    changes = git("status", "--porcelain", "--", ":/", *others)
    return git("rev-parse", "--short=8", "HEAD") + ("+" if changes else "")
