"""Runs the named benchmarks, or all, and prints their metrics with limits."""

import importlib
import sys

from rich.console import Console
from rich.table import Table

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
    """Run the benchmarks; return 0 if every metric is within its limit."""
    names = sys.argv[1:] or list(BENCHMARKS)
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"unknown benchmark {', '.join(unknown)}; choose from {', '.join(BENCHMARKS)}")
        return 2
    kept = True
    for name in names:
        metrics = importlib.import_module(f"benchmarks.{name}").measure()
        table = Table(box=None, pad_edge=False, title=name, title_justify="left")
        for column in ("metric", "value", "limit", "", "note"):
            table.add_column(column)
        for metric in metrics:
            kept = kept and metric.kept
            verdict = "" if not metric.limit else ("kept" if metric.kept else "MISSED")
            value = f"{metric.value:.3g} {metric.unit}"
            table.add_row(metric.name, value, metric.limit, verdict, metric.note)
        Console(width=150).print(table)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
