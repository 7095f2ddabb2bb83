"""Ten component processes with OpenCV, SciPy and a compiled kernel: start, restart, memory."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import psutil
import yaml
from scipy import ndimage

from cairn import Out, every
from cairn.runtime.component import Component
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn_lab.benchmarks.result import Metric

COUNT = 10
_HERE = "cairn_lab.benchmarks.startup"


def _energy(values: Any) -> Any:
    total = 0.0
    for value in values:
        total += value * value
    return total


# A kernel compiled when this module is imported: in the zygote, once for all.
energy: Any = numba.njit("float64(float64[:])", cache=True)(_energy)


class Heavy(Component):
    """Uses all three libraries in every call."""

    out: Out[Twist]

    @every(hz=10)
    def work(self) -> None:
        """Blur, label, sum."""
        grid = cv2.GaussianBlur(np.eye(64), (5, 5), 1.0)
        _, count = ndimage.label(grid > 0.1)
        self.out.publish(Twist(linear=Vector3(x=energy(grid.ravel()), y=float(count))))


class _Up:
    """A running `cairn up`, whose output can be awaited."""

    def __init__(self, file: Path, report: Path) -> None:
        self.began = time.monotonic()
        command = [
            sys.executable,
            "-m",
            "cairn.cli.program",
            "up",
            str(file),
            "--report",
            str(report),
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.lines: list[tuple[float, str]] = []
        self._changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def wait_for(self, found: Callable[[list[tuple[float, str]]], Any], limit_s: float) -> Any:
        """Return the result of `found` on the lines, once it is not None."""
        with self._changed:
            if not self._changed.wait_for(lambda: found(self.lines) is not None, limit_s):
                text = "\n".join(line for _, line in self.lines)
                raise RuntimeError(f"did not happen within {limit_s} s:\n{text}")
            return found(self.lines)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self.lines.append((time.monotonic(), line.rstrip()))
                self._changed.notify_all()


def _actives(lines: list[tuple[float, str]], name: str) -> list[float]:
    return [when for when, line in lines if line.endswith(f": child active: {name}")]


def measure() -> list[Metric]:
    """Measure from `cairn up` to all active, from SIGKILL to active again, and the PSS of each."""
    names = [f"heavy_{index}" for index in range(COUNT)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bench.yaml"
        components = {
            name: {"plugin": f"{_HERE}:Heavy", "topics": {"out": f"{name}_out"}} for name in names
        }
        socket = f"{folder}/bus.sock"
        document = {"cairn": 1, "bus": {"socket": socket}, "components": components}
        file.write_text(yaml.safe_dump(document, sort_keys=False))
        up = _Up(file, Path(folder) / "run")
        try:
            last = up.wait_for(lambda lines: next(iter(_actives(lines, names[-1])), None), 60)
            start_s = last - up.began
            pids = _pids(socket)
            memory = [psutil.Process(pid).memory_full_info().pss / 2**20 for pid in pids.values()]
            victim = names[3]
            killed_at = time.monotonic()
            os.kill(pids[victim], signal.SIGKILL)
            back = up.wait_for(lambda lines: next(iter(_actives(lines, victim)[1:]), None), 30)
        finally:
            up.process.send_signal(signal.SIGINT)
            up.process.wait(60)
    return [
        Metric(f"`cairn up` of {COUNT} heavy components: all active", start_s, "s", 2.0),
        Metric("component killed with SIGKILL: active again", back - killed_at, "s", 0.5),
        Metric(
            "memory of each (PSS), largest", max(memory), "MiB", 25.0,
            note=f"mean {sum(memory) / len(memory):.1f} MiB",
        ),
    ]  # fmt: skip


def _pids(connect: str) -> dict[str, int]:
    command = [sys.executable, "-m", "cairn.cli.program", "ps", "--json", "--connect", connect]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    return {
        row["component"].rpartition("/")[2]: row["pid"]
        for row in json.loads(done.stdout)
        if row["component"].rpartition("/")[2].startswith("heavy_")
    }
