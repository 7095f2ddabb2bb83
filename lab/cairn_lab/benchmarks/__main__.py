"""Runs the named benchmarks, or all; prints their metrics with limits, and records them."""

import argparse
import importlib
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from cairn_lab.benchmarks.results import RESULTS, Figure, Results, Run, record

BENCHMARKS = (
    "roundtrip",
    "services",
    "links",
    "machines",
    "latency",
    "startup",
    "lockstep",
    "replay",
    "planning",
    "localization_scan",
    "localization_logs",
    "slam",
    "slam_landmarks",
    "slam_live",
    "lifelong",
    "world",
    "recognition",
    "camera",
    "v4l2_camera",
    "hokuyo",
    "navigation",
    "exchanged_objects",
    "explore",
    "velocity_gate",
    "sharing",
    "recorder",
    "silent_peers",
    "console",
    "vision",
)


def main() -> int:
    """Run the benchmarks, or write the page; return 0 if every metric is within its limit."""
    parser = argparse.ArgumentParser(prog="python -m cairn_lab.benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument(
        "--results", type=Path, default=RESULTS, metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument(
        "--page", type=Path, nargs="?", const=Path("docs/benchmarks.md"), metavar="FILE",
        help="only write the tables of this page from the results (%(const)s)",
    )  # fmt: skip
    options = parser.parse_args()
    if options.page:
        page = Results.read(options.results).page(options.page.read_text())
        options.page.write_text(page)
        return 0
    if unknown := [name for name in options.names if name not in BENCHMARKS]:
        parser.error(f"unknown benchmark {', '.join(unknown)}; choose from {', '.join(BENCHMARKS)}")
    kept = True
    for name in options.names or BENCHMARKS:
        metrics = importlib.import_module(f"cairn_lab.benchmarks.{name}").measure()
        table = Table(box=None, pad_edge=False, title=name, title_justify="left")
        for column in ("metric", "value", "limit", "", "note"):
            table.add_column(column)
        for metric in metrics:
            kept = kept and metric.kept
            verdict = "" if not metric.limit else ("kept" if metric.kept else "MISSED")
            text = Figure.of(metric).text
            table.add_row(metric.name, text, metric.limit, verdict, metric.note)
        Console(width=150).print(table)
        if metrics:
            record(options.results, name, Run.now(metrics))
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
