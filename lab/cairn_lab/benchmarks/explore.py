"""Exploration of simulated worlds in lockstep, and navigation on the maps that it makes."""

import json
import math
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from cairn.components.simulation.world_file import read_world
from cairn.planar.map_file import read_map
from cairn.schemas.cairn_nav_msgs import Collision, ExplorationStatus
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.testing.lockstep import DeploymentHarness
from cairn_lab.benchmarks.lockstep import ROOT
from cairn_lab.benchmarks.result import Metric
from cairn_lab.evaluation.map_comparison import (
    ROBOT_RADIUS_M,
    WALL_M,
    MapComparison,
    compare_with_world,
)

_MAPPING = ROOT / "deploy" / "mapping.yaml"
_WORLDS = ROOT / "deploy" / "worlds"
# Worlds with limits; further ones are reported. The hall has ten walking people.
_REQUIRED, _REPORTED = ("room", "office"), ("museum", "ward", "hall")
_LIMIT_S = 1800.0
_GOALS, _SEEDS = 20, 10


@dataclass(frozen=True)
class Explored:
    """The result of an exploration: its last status, and what is true of it."""

    status: ExplorationStatus
    driven_m: float
    collisions: int
    map: MapComparison


def measure() -> list[Metric]:
    """Explore each world, and drive to random goals on the maps of room and office."""
    metrics = []
    with tempfile.TemporaryDirectory() as name:
        for world in (*_REQUIRED, *_REPORTED):
            folder = Path(name) / world
            folder.mkdir()
            metrics += _metrics(world, explore(world, folder))
        for world in _REQUIRED:
            metrics += _goals(world, Path(name) / world)
    return metrics


def explore(world: str, folder: Path, seed: int = 0) -> Explored:
    """Explore a shipped world in lockstep; the map is `map.yaml` in the folder."""
    file = _WORLDS / f"{world}.yaml"
    sets = [
        f"settings.world={file}",
        f"settings.report={folder}",
        "settings.explore=on_activation",
        "settings.finish=true",
    ]
    driven = _Driven()
    with DeploymentHarness(_MAPPING, sets=sets, seed=seed) as robot:
        statuses = robot.read("exploration_status", ExplorationStatus)
        collisions = robot.read("collisions", Collision)
        truth = robot.read("truth", PoseStamped, on_message=lambda: driven.add(truth.take()[-1]))
        robot.run_to_end(_LIMIT_S)
    start = read_world(file).robot.pose
    compared = compare_with_world(read_map(folder / "map.yaml"), file, start, ROBOT_RADIUS_M)
    return Explored(statuses.messages[-1], driven.meters, len(collisions.messages), compared)


class _Driven:
    def __init__(self) -> None:
        self.meters = 0.0
        self._last: tuple[float, float] | None = None

    def add(self, truth: PoseStamped) -> None:
        at = truth.pose.position.x, truth.pose.position.y
        self.meters += math.dist(self._last or at, at)
        self._last = at


def _metrics(world: str, found: Explored) -> list[Metric]:
    required = world in _REQUIRED
    status = found.status
    took = f"{status.elapsed:.0f} s, {found.driven_m:.0f} m; {status.reason}"
    return [
        Metric(f"{world}: of the reachable area known", 100.0 * found.map.known, "%",
               at_least=99 if required else None, note=took),
        Metric(f"{world}: walls within {100 * WALL_M:g} cm", 100.0 * found.map.within(WALL_M), "%",
               at_least=95 if required else None),
        Metric(f"{world}: collisions", float(found.collisions), "", at_most=0),
    ]  # fmt: skip


def _goals(world: str, folder: Path) -> list[Metric]:
    command = [sys.executable, "-m", "cairn.cli.program", "evaluate", "navigation"]
    command += ["--world", str(_WORLDS / f"{world}.yaml"), "--map", str(folder / "map.yaml")]
    command += ["--goals", str(_GOALS), "--seeds", f"0..{_SEEDS - 1}"]
    command += ["--out", str(folder / "evaluation"), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    if not done.stdout:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
    summary = json.loads(done.stdout)["summary"]
    return [
        Metric(f"{world}, on its own map: random goals reached",
               100.0 * summary["reached"] / summary["goals"], "%", at_least=99,
               note=f"{summary['reached']} of {summary['goals']}"),
        Metric(f"{world}, on its own map: collisions", float(summary["collisions"]), "",
               at_most=0),
    ]  # fmt: skip
