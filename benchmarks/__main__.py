"""Runs the benchmarks named, or all, and prints their figures with limits."""

import importlib
import sys

from rich.console import Console
from rich.table import Table

BENCHMARKS = (
    "roundtrip",
    "latency",
    "startup",
    "lockstep",
    "replay",
    "planning",
    "localization_scan",
    "localization_logs",
    "world",
    "recognition",
    "camera",
    "v4l2_camera",
    "hokuyo",
    "navigation",
    "vision",
)


def main() -> int:
    """0 if every figure keeps its limit."""
    names = sys.argv[1:] or list(BENCHMARKS)
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"there is no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
        return 2
    kept = True
    for name in names:
        figures = importlib.import_module(f"benchmarks.{name}").measure()
        table = Table(box=None, pad_edge=False, title=name, title_justify="left")
        for column in ("figure", "value", "limit", "", "note"):
            table.add_column(column)
        for figure in figures:
            kept = kept and figure.kept
            verdict = "" if not figure.limit else ("kept" if figure.kept else "MISSED")
            value = f"{figure.value:.3g} {figure.unit}"
            table.add_row(figure.name, value, figure.limit, verdict, figure.note)
        Console(width=150).print(table)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
