"""Replay of a real recording in processes at 10 times real time, undisturbed and with kills."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from cairn_lab.benchmarks.lockstep import (
    DEPLOYMENT,
    DISPLACED,
    make_map,
    run_replay,
    wrong_positions,
)
from cairn_lab.benchmarks.result import Metric

_PATH = ("localizer.objects", "map_builder.object_evidence", "localizer.visual_map")
"""The inputs on the path from an observation to the map."""


def measure() -> list[Metric]:
    """Measure accuracy and lost messages in real processes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        displaced = make_map(folder / "displaced.cairn", *DISPLACED)
        settings = ("--set", f"visual_map={displaced}", "--set",
                    f"bus.socket={folder}/bus.sock")  # fmt: skip
        plain, _ = run_replay(folder / "plain", *settings, "--seed", "1")
        killed = _with_kills(folder / "killed", displaced)
    return [
        Metric("replay at 10 times real time: times real time",
               plain["recorded_s"] / plain["wall_s"], "x", at_least=9.0),
        *_accuracy("undisturbed", plain),
        Metric("undisturbed: dropped between observation and map",
               float(sum(plain["dropped"][port] for port in _PATH)), "", at_most=0),
        *_accuracy("localizer and map_builder killed", killed),
    ]  # fmt: skip


def _accuracy(name: str, report: dict[str, Any]) -> list[Metric]:
    return [
        Metric(f"{name}: position error", report["position_rmse_m"], "m rms", at_most=0.30),
        Metric(f"{name}: landmarks 0.3 m or more from the truth",
               float(wrong_positions(report)), "", at_most=0),
    ]  # fmt: skip


def _with_kills(folder: Path, visual_map: Path) -> dict[str, Any]:
    """Run again; kill the localizer when the first landmark is removed, then the map builder."""
    socket = str(folder.parent / "bus.sock")
    command = [sys.executable, "-m", "cairn.cli.program", "up", str(DEPLOYMENT), "--seed", "1",
               "--report", str(folder), "--set", f"visual_map={visual_map}",
               "--set", f"bus.socket={socket}"]  # fmt: skip
    victims = ["localizer", "map_builder"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as up:
        assert up.stdout is not None
        for line in up.stdout:
            if victims and " REMOVED" in line:
                _kill(socket, victims.pop(0))
        if up.wait(60) != 0 or victims:
            raise RuntimeError(f"the run failed, or {victims} could not be killed")
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def _kill(connect: str, name: str) -> None:
    command = [sys.executable, "-m", "cairn.cli.program", "ps", "--json", "--connect", connect]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    for row in json.loads(done.stdout):
        if row["component"].endswith(f"/{name}"):
            os.kill(row["pid"], signal.SIGKILL)
