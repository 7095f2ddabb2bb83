"""A robot is carried away in the moment in which all objects of its map exchange their places.

The objects that it sees then contradict every position, and scans must decide. In the museum they
cannot: turned by half a turn it looks the same.

    python -m cairn_lab.benchmarks.exchanged_objects [museum ...]
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.ndimage import label

from cairn.components.simulation.survey import surveyed_grid
from cairn.components.simulation.world_file import read_world
from cairn.planar.grid import FREE, distance_field
from cairn.planar.poses import Pose
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.world import WORLDS

_LIMITS: dict[str, float | None] = {
    "room": 100.0,
    "office": 100.0,
    "hall": 100.0,
    "ward": None,
    "museum": None,
}
"""The least share of goals that must be reached in each world [%]."""
_TRIES, _GOALS = 8, 3
_AT_S = 10.0
_ROBOT_M, _ROOM_M = 0.35, 0.6  # what the robot needs to drive, and to be put down [m]


def measure() -> list[Metric]:
    """Return the metrics of all worlds."""
    return list(_metrics(tuple(_LIMITS)))


def _metrics(worlds: Sequence[str]) -> Iterator[Metric]:
    """Make the tries in each world; yield shares of goals reached, and times until found."""
    for world in worlds:
        least = _LIMITS[world]
        found = [_try(WORLDS / f"{world}.yaml", seed) for seed in range(_TRIES)]
        times = [one["relocalized_worst_s"] for one in found if one["relocalized"]]
        note = f"found {len(times)} of {_TRIES} times"
        if times:
            note += f", after {np.median(times):.1f} s (median), {max(times):.1f} s (longest)"
        share = 100.0 * sum(one["reached"] for one in found) / (_TRIES * _GOALS)
        yield Metric(f"{world}: goals reached", share, "%", at_least=least, note=note)
        misled = max(one["misled_s"] for one in found)
        yield Metric(f"{world}: longest time sure of a wrong pose", misled, "s")
        collisions = sum(one["collisions"] for one in found)
        yield Metric(f"{world}: collisions", collisions, "", at_most=0)


def _try(world: Path, seed: int) -> dict[str, Any]:
    """Return the summary of `cairn evaluate navigation` in a copy of the world with the events."""
    draw = random.Random(seed)
    data = yaml.safe_load(world.read_text(encoding="utf-8"))
    names = [one.display_name for one in read_world(world).objects]
    draw.shuffle(names)
    # Each exchange moves the first object on: in the end all have another place.
    events = [{"at": _AT_S, "swap": [names[0], other]} for other in names[1:]]
    x, y, theta = _free_pose(world, draw)
    events.append({"at": _AT_S, "kidnap": {"x": x, "y": y, "theta": theta}})
    data["events"] = [*data.get("events", []), *events]
    for one in data["objects"]:
        if "texture" in one:
            one["texture"] = str(world.parent / one["texture"])
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / world.name
        file.write_text(yaml.safe_dump(data), encoding="utf-8")
        command = [sys.executable, "-m", "cairn.cli.program", "evaluate", "navigation"]
        command += ["--world", str(file), "--goals", str(_GOALS), "--seeds", f"{seed}..{seed}"]
        command += ["--workers", "1", "--no-cache", "--json", "--out", f"{name}/report"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    if done.returncode not in (0, 1):  # 1: not all goals were reached
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")
    summary: dict[str, Any] = json.loads(done.stdout)["summary"]
    return summary


def _free_pose(world: Path, draw: random.Random) -> Pose:
    """Return a pose that the robot can reach from its start, with some room around it."""
    grid = surveyed_grid(world)
    clearance = distance_field(np.asarray(grid.values != FREE), grid.frame.resolution)
    areas, _ = label(clearance > _ROBOT_M)
    start = read_world(world).robot.pose
    reachable = areas == areas[grid.frame.cell(start[0], start[1])]
    row, column = draw.choice(np.argwhere(reachable & (clearance > _ROOM_M)).tolist())
    x, y = grid.frame.point(row, column)
    return (x, y, draw.uniform(-3.1, 3.1))


def main() -> None:
    for one in _metrics(sys.argv[1:] or tuple(_LIMITS)):
        verdict = "" if not one.limit else f" ({one.limit} {'kept' if one.kept else 'MISSED'})"
        print(f"{one.name}: {one.value:g} {one.unit}{verdict} {one.note}", flush=True)


if __name__ == "__main__":
    main()
