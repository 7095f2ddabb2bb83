"""Replay of a real recording in lockstep: speed, reproducibility and accuracy."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from cairn_lab.benchmarks.result import Metric

ROOT = Path(__file__).parents[3]
DEPLOYMENT = ROOT / "deploy" / "replay_mrclam.yaml"
DATASET = ROOT / "tests" / "data" / "mrclam" / "MRCLAM_Dataset6"
DISPLACED = ("--displace", "11:-1.2,0.9", "--displace", "20:0.6,-1.6")


def make_map(file: Path, *changes: str) -> Path:
    """Write a visual map of the data set's landmarks with the given changes."""
    _cairn("map", "import", "mrclam", str(DATASET), str(file), *changes)
    return file


def run_replay(folder: Path, *arguments: str) -> tuple[dict[str, Any], float]:
    """Replay the recording with `cairn up`; return report.json and the duration [s]."""
    began = time.monotonic()
    _cairn("up", str(DEPLOYMENT), "--report", str(folder), *arguments)
    took = time.monotonic() - began
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report, took


def _cairn(*arguments: str) -> None:
    command = [sys.executable, "-m", "cairn.cli.program", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")


def measure() -> list[Metric]:
    """Measure robots 2 and 5 on one core, with a true map and with two landmarks displaced."""
    metrics = []
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # inherited by child processes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        true_map = make_map(folder / "true.cairn")
        displaced = make_map(folder / "displaced.cairn", *DISPLACED)
        for robot in (2, 5):
            settings = ("--lockstep", "--seed", "1", "--set", f"recording.robot={robot}")
            still, took = run_replay(folder / f"a{robot}", *settings, "--set",
                                     f"visual_map={true_map}")  # fmt: skip
            metrics += [
                Metric(f"robot {robot}, lockstep: times real time, start and report included",
                       still["recorded_s"] / took, "x", at_least=30,
                       note=f"{still['recorded_s']:.0f} s in {took:.1f} s"),
                Metric(f"robot {robot}, map true: position error",
                       still["position_rmse_m"], "m rms", at_most=0.25),
            ]  # fmt: skip
            moved, _ = run_replay(folder / f"b{robot}", *settings, "--set",
                                  f"visual_map={displaced}")  # fmt: skip
            run_replay(folder / f"c{robot}", *settings, "--set", f"visual_map={displaced}")
            written = [(folder / f"{run}{robot}" / "report.json").read_bytes() for run in "bc"]
            metrics += [
                Metric(f"robot {robot}, two displaced: position error",
                       moved["position_rmse_m"], "m rms", at_most=0.30),
                Metric(f"robot {robot}, two displaced: landmarks 0.3 m or more from the truth",
                       float(wrong_positions(moved)), "", at_most=0),
                Metric(f"robot {robot}, two displaced: same seed, report.json differs",
                       float(written[0] != written[1]), "", at_most=0),
            ]  # fmt: skip
    return metrics


def wrong_positions(report: dict[str, Any]) -> int:
    """Return how many landmarks are lost, or 0.3 m or more from their true position."""
    return sum(
        thing["state"] != "live"
        or (thing["x"] - thing["true_x"]) ** 2 + (thing["y"] - thing["true_y"]) ** 2 >= 0.3**2
        for thing in report["objects"]
    )
