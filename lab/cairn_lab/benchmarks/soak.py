"""The simulated robot drives between goals for long: growth of memory, descriptors, threads, disk.

    python -m cairn_lab.benchmarks.soak --minutes 60

Each process is sampled every 5 s. The first minutes (`--warm-up`) fill caches and pools. Growth is
that from the least value in the first two minutes after them to that in the last two, so that what
a process uses for a while does not count. The start is unknown, so that the global
search, which a robot needs now and then, takes its memory in the first minutes as well. Exit status
1 if anything grew by more than 2 %.
"""

import argparse
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import psutil
from rich.console import Console
from rich.table import Table

import cairn.client
from cairn.deployment.shipped import FOLDER
from cairn.errors import CairnError
from cairn.schemas.cairn_nav_msgs import NAVIGATION_STATES
from cairn.testing.launching import Run, launching
from cairn_lab.campaign.growth import anonymous_memory_mib, growth_percent

GOALS = ((7.5, 5.0, 0.0), (1.5, 1.2, 0.0))
"""Poses [m, m, rad] in the simulated room, far from each other."""
PERIOD_S = 5.0
LIMIT_PERCENT = 2.0
_GOAL_LIMIT_S = 180.0
_QUANTITIES = ("anonymous memory [MiB]", "descriptors", "threads")

Samples = dict[tuple[str, str], list[tuple[float, float]]]
"""Time since the start [s] and value, by process and quantity."""


def sample(run: Run, at_s: float, samples: Samples) -> None:
    """Add one sample of every process of the run, and of the size of its report folder."""
    for pid in run.pids():
        with suppress(psutil.Error):  # it has just ended
            process = psutil.Process(pid)
            name = process.cmdline()[0] if process.pid != run.process.pid else "cairn: root"
            values = (anonymous_memory_mib(process), process.num_fds(), process.num_threads())
            for quantity, value in zip(_QUANTITIES, values, strict=True):
                samples[name, quantity].append((at_s, float(value)))
    files = [path for path in run.report.rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files if path.exists())
    samples["report folder", "disk [MiB]"].append((at_s, size / 2**20))


def drive(run: Run, ended: threading.Event, reached: list[str]) -> None:
    """Send the robot from goal to goal; `reached` gets the result of each."""
    with cairn.client.connect(run.endpoint) as robot:
        while not ended.is_set():
            for goal in GOALS:
                try:
                    with robot.go(*goal) as mission:
                        result = mission.result(_GOAL_LIMIT_S)
                    state = NAVIGATION_STATES[result.state]
                    reached.append(f"{state}: {result.reason}" if result.reason else state)
                except CairnError as error:
                    reached.append(str(error))
                if ended.is_set():
                    return


def grown(samples: Samples, since_s: float) -> Mapping[tuple[str, str], float]:
    """Return the growth [%] of each quantity of each process."""
    return {key: growth_percent(values, since_s) for key, values in sorted(samples.items())}


def main() -> int:
    """Run the soak; return 1 if something has grown beyond the limit."""
    parser = argparse.ArgumentParser(
        prog="python -m cairn_lab.benchmarks.soak", description=__doc__
    )
    parser.add_argument("--minutes", type=float, default=60.0, help="duration")
    parser.add_argument("--warm-up", type=float, default=10.0, help="minutes that do not count")
    options = parser.parse_args()
    if options.minutes < options.warm_up + 5:
        parser.error("growth shows five minutes after the warm-up: give more --minutes")
    samples: Samples = defaultdict(list)
    reached: list[str] = []
    with tempfile.TemporaryDirectory() as folder, launching(Path(folder)) as launch:
        run = launch(FOLDER / "sim.yaml", "--plain", "--set", "start=null")
        run.await_line("child active: mobile_supervisor")
        ended = threading.Event()
        driver = threading.Thread(target=drive, args=(run, ended, reached), daemon=True)
        driver.start()
        began = time.monotonic()
        while (at_s := time.monotonic() - began) < options.minutes * 60:
            sample(run, at_s, samples)
            ended.wait(PERIOD_S)
        ended.set()
    growth = grown(samples, options.warm_up * 60)
    table = Table(box=None, pad_edge=False)
    for column in ("process", "quantity", "last", "growth %", ""):
        table.add_column(column)
    for (name, quantity), percent in growth.items():
        verdict = "GROWS" if percent > LIMIT_PERCENT else ""
        last = samples[name, quantity][-1][1]
        table.add_row(name, quantity, f"{last:.1f}", f"{percent:+.2f}", verdict)
    Console(width=120).print(table)
    for result, times in Counter(reached).most_common():
        print(f"{times} goals {result}")
    return int(any(percent > LIMIT_PERCENT for percent in growth.values()))


if __name__ == "__main__":
    sys.exit(main())
