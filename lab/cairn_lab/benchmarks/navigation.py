"""Navigation in the simulated room: speed in lockstep; processor and latency in real processes."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
import yaml

from cairn import In, Out, on
from cairn.bus.qos import SENSOR
from cairn.components.motion_control.component import MotionControl
from cairn.planar.scans import sweep_s
from cairn.runtime.component import Component
from cairn.schemas.builtin_interfaces import from_ns, to_ns
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.system.clock import SECOND
from cairn_lab.benchmarks.lockstep import ROOT
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.running import results

_SIM = ROOT / "deploy" / "sim.yaml"
_TOUR = ROOT / "deploy" / "demo_tour.yaml"
_PARTICLES = 2000
_BEGINS_S, _MEASURED_S = 10.0, 30.0
_LAPS = 4


class AnsweringMotionControl(MotionControl):
    """Publishes, after the command that a scan caused, when the scan's last beam was measured.

    A command does not contain its cause: many are sent by a timer, and one may arrive at a third
    process before the scan that caused it.
    """

    answered: Out[Header] = Out(qos=SENSOR)

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Publish the command, then the time of the last beam."""
        super().on_scan(scan)
        last_beam = to_ns(scan.header.stamp) + round(sweep_s(scan) * SECOND)
        self.answered.publish(Header(stamp=from_ns(last_beam)))


class Stopwatch(Component):
    """Measures the time from a scan's last beam to the arrival of its command."""

    answered: In[Header] = In(qos=SENSOR)

    def on_activate(self) -> None:
        """Start without measured times."""
        self._times_ms: list[float] = []

    @on("answered")
    def on_answered(self, scan: Header) -> None:
        """Record the delay: the command arrived just before this message."""
        self._times_ms.append((self.clock.now() - to_ns(scan.stamp)) / 1e6)

    def on_deactivate(self) -> None:
        """Log the result."""
        ordered = sorted(self._times_ms)
        last = len(ordered) - 1
        found = {"median_ms": ordered[last // 2], "p95_ms": ordered[int(0.95 * last)]}
        self.log.info("RESULT %s", json.dumps({**found, "count": len(ordered)}))


def measure() -> list[Metric]:
    """Measure a tour in lockstep on one core, and the same tour in real time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        report, took = _in_lockstep(folder / "lockstep")
        busy, latency = in_real_time(folder)
    return [
        Metric(
            "tours of the room in lockstep, one core: times real time, start and report included",
            report["recorded_s"] / took,
            "x",
            at_least=20,
            note=f"{report['recorded_s']:.0f} s in {took:.1f} s",
        ),
        Metric("the same: position error", report["position_rmse_m"], "m rms", at_most=0.05),
        Metric("the same: collisions", float(len(report["collisions"])), "", at_most=0),
        Metric(
            f"all processes at 10 scans a second and {_PARTICLES} particles: of two cores",
            100.0 * busy / 2.0,
            "%",
            at_most=60,
        ),
        Metric(
            "last beam of a scan to velocity command: p95",
            latency["p95_ms"],
            "ms",
            at_most=50,
            note=f"median {latency['median_ms']:.1f} ms of {latency['count']}",
        ),
    ]


def _in_lockstep(folder: Path) -> tuple[dict[str, Any], float]:
    mission = yaml.safe_load(_TOUR.read_text(encoding="utf-8"))["settings"]["mission"]
    command = [*_command(folder), "--overlay", str(_TOUR), "--lockstep"]
    command += ["--set", f"mission={json.dumps(_LAPS * mission)}"]
    began = time.monotonic()
    core = min(os.sched_getaffinity(0))
    done = subprocess.run(
        ["taskset", "-c", str(core), *command],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    took = time.monotonic() - began
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report, took


def in_real_time(folder: Path, *arguments: str) -> tuple[float, dict[str, float]]:
    """Return the mean number of busy processors while the robot drives the tour, and the latencies.

    `arguments` are further ones of `cairn up`; the report is in `folder`/real.
    """
    overlay = folder / "measured.yaml"
    localizer = {"parameters": {"particles": _PARTICLES}}
    motion_control = {"plugin": f"{__name__}:{AnsweringMotionControl.__name__}"}
    automove = {"children": {"localizer": localizer, "motion_control": motion_control}}
    stopwatch = {"plugin": f"{__name__}:{Stopwatch.__name__}"}
    overlay.write_text(
        yaml.safe_dump(
            {
                "components": {
                    "mobile_supervisor": {"children": {"automove": automove}},
                    "stopwatch": stopwatch,
                }
            }
        )
    )
    command = _command(folder / "real")
    command += ["--overlay", str(_TOUR), "--overlay", str(overlay)]
    command += ["--set", f"bus.socket={folder}/bus.sock", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as up:
        time.sleep(_BEGINS_S)  # the benchmark measures an interval of time
        before = _used_s(up.pid)
        time.sleep(_MEASURED_S)
        used_s = _used_s(up.pid) - before
        output, _ = up.communicate(timeout=300)
    if up.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{output}")
    return used_s / _MEASURED_S, results(output)[0]


def _used_s(pid: int) -> float:
    """Return the processor time [s] of a process and all its descendants."""
    root = psutil.Process(pid)
    total = 0.0
    for process in [root, *root.children(recursive=True)]:
        times = process.cpu_times()
        total += times.user + times.system
    return total


def _command(folder: Path) -> list[str]:
    up = [sys.executable, "-m", "cairn.cli.program", "up", str(_SIM)]
    return [*up, "--report", str(folder), "--plain"]
