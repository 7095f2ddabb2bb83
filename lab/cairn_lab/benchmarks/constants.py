"""What changes with half and with double of each tuned constant of the navigation components.

    python -m cairn_lab.benchmarks.constants [--only TEXT] [--jobs 2] [--again | --check]

A tuned constant is a number, or a tuple or array of numbers, with a name in capital letters in a
module of these components. For each of them, one after the other, a copy of the code is changed;
simulated drives and recordings, all in virtual time, then show the effect. The results are written
to `lab/constants.yaml` as they come. Constants whose value has not changed since are not
measured again, unless `--again` is given; `--check` lists those that have to be. A share of 0.5 or
more, named in `SHARES`, cannot be doubled: its distance to 1 is halved instead.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import yaml

from cairn import CairnError
from cairn.deployment.shipped import FOLDER, world_file
from cairn_lab.benchmarks.localization_logs import LOST_M, starts
from cairn_lab.benchmarks.localization_mrclam import Case, solve
from cairn_lab.benchmarks.lockstep import DATASET, ROOT
from cairn_lab.benchmarks.slam_scenarios import mapped_drive, mapped_log, mapped_objects
from cairn_lab.evaluation.runs import Trial, robot_start, run_trial, survey
from tests.components.corrected_logs import (
    LOGS,
    draw_map,
    from_known_start,
    load_log,
    mapped_by_stretches,
)

FILE = ROOT / "lab" / "constants.yaml"

SCENARIOS = {
    "automove": ("hall", "office"),
    "motion_control": ("hall", "office"),
    "path_planner": ("hall", "office"),
    "map_builder": ("displaced",),
    "map_builder/occupancy.py": ("tour",),
    "map_builder/grid_from_scans.py": ("tour", "log"),
    "localizer": ("log",),
    **dict.fromkeys(
        (
            "localizer/absence_detector.py",
            "localizer/landmark_evidence.py",
            "localizer/messages.py",
            "localizer/observations.py",
            "localizer/recent_observations.py",
        ),
        ("found",),
    ),
    "slam": ("mapped_log", "mapped_drive"),
    "slam/landmarks.py": ("mapped_objects",),
    "slam/odometry_calibration.py": ("mapped_objects",),
    "slam/odometry_log.py": ("mapped_objects",),
    **dict.fromkeys(
        (
            "slam/graph_file.py",
            "slam/graph_history.py",
            "slam/lifelong.py",
            "slam/map_differences.py",
        ),
        (),
    ),
}
"""The scenarios of each component, and of modules that need others.

Modules with none are left out: limits of files, and lifelong maps, whose effects need hours.
"""

SHARES = frozenset(
    {
        *("_SEEN_SHARE", "_MARGIN_SHARE", "_TURN_SHARE", "_MEETING"),
        *("_UNAMBIGUOUS", "_DOUBTFUL_FIT", "_LOST_OF_USUAL_FIT", "_GOOD_FIT", "_OF_USUAL_FIT"),
        *("_USUAL_BAD", "_MOST_OF_THEM", "MOST", "MOST_SIMILARITY", "_MOST_RELIABILITY"),
        *("_LEAST_SCORE", "_LEAST_SCORE_ANYWHERE", "_LEAST_PAIRED", "_SAME_SIDE", "_SHRINK"),
        *("_NO_FIT_OF_USUAL", "_POOR_FIT", "_CONTINUED_FIT", "_FITS", "_MOST_WITHOUT_POINTS"),
        *("_LEAST_SHARE", "_MOVED_SHARE"),
    }
)

NOT_TUNED = frozenset(
    {
        *("SECOND_NS", "_NS_PER_MS"),  # units
        *("_GOAL_ID_MODULUS", "_NEVER", "STAND", "_STAMP", "_ROW", "_COLUMN", "BLOCKED", "NO_RAYS"),
        *("UNLIMITED_M", "_MAX_COORDINATE_M"),  # more than any
        *("_RADIUS_95", "_KLD_QUANTILE", "_GOLDEN", "ACCEPTED"),  # mathematics
        "MAX_SHOWN_POSES",  # for display
        *("_NEXT_PLACE", "_ITSELF", "_NO_SURFACE", "_NS_PER_S"),  # numbers with a meaning, units
    }
)
"""Constants of these modules that were not chosen for their effect on navigation."""

LIMIT_S = 300.0
"""A process that takes longer fails: with present values it takes 10 to 20 s of a core."""

_HEADER = """\
# Effects of half and double of each tuned constant, by `python -m cairn_lab.benchmarks.constants`.
# `same`: not the least difference, so these runs say nothing about the constant.
#   hall: two goals among ten walking people, kidnapped on the way to the second one; office: one
#     goal, through doors. Goals reached, collisions, time [s], 95th percentile of the position
#     error [m].
#   displaced: robot 2 of MRCLAM, with two landmarks displaced in its map; found: robot 5, one
#     displaced, from an unknown start. Position error [m rms], landmarks that are wrong in the end.
#   log: the log fr101 in a map of other stretches of it. Median position error [m], scans at which
#     it was more than 1 m, and how many of 5 unknown starts ended within 0.5 m of the truth.
#   mapped_log: the first 100 s of fr079. Errors of the relations [m], [degrees], closures and
#     matches, keyframes. mapped_drive: the component in the office. Error of the poses while
#     driving [m rms], scans with a pose, occupied cells.
#     mapped_objects: 60 s without a scanner. Error of the objects [m rms], how many, turn gain.
#   tour: the demo's tour of a room that is rearranged. Position error [m rms], landmarks 0.3 m or
#     more from the truth, collisions, time [s].
"""


@dataclass(frozen=True)
class Constant:
    """A tuned constant: where it is defined, and its expression in the source."""

    file: str
    name: str
    source: str

    @property
    def scenarios(self) -> tuple[str, ...]:
        """The scenarios that show its effect."""
        _, component, module = self.file.split("/")
        return SCENARIOS.get(f"{component}/{module}", SCENARIOS[component])


def constants() -> Iterator[Constant]:
    """Yield all tuned constants, in the order of the source."""
    for component in (name for name in SCENARIOS if "/" not in name):
        for path in sorted((ROOT / "components" / component).glob("*.py")):
            file = str(path.relative_to(ROOT))
            module = importlib.import_module(f"cairn.components.{component}.{path.stem}")
            for name, value in _assignments(ast.parse(path.read_text("utf-8"))):
                constant = Constant(file, name, ast.unparse(value))
                is_tuned = name not in NOT_TUNED and _is_numeric(getattr(module, name))
                if is_tuned and constant.scenarios:
                    yield constant


def _assignments(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Yield name and value of each constant that a module assigns."""
    for node in tree.body:
        for name, value in _pairs(node):
            if isinstance(name, ast.Name) and name.id == name.id.upper():
                yield name.id, value


def _pairs(node: ast.stmt) -> Iterator[tuple[ast.expr, ast.expr]]:
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        yield node.target, node.value
    elif isinstance(node, ast.Assign):
        [target] = node.targets
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from zip(target.elts, node.value.elts, strict=True)
        else:
            yield target, node.value


def _is_numeric(value: object) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(_is_numeric(one) for one in value)
    if isinstance(value, np.ndarray):
        return bool(value.dtype == np.float64)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def changed_source(source: str, constant: Constant, factor: float) -> str:
    """Return the source of a module with one constant multiplied by a factor."""
    tree = ast.parse(source)
    for name, value in _assignments(tree):
        if name == constant.name:
            start = _offset(source, value.lineno, value.col_offset)
            end = _offset(source, value.end_lineno or 0, value.end_col_offset or 0)
            return source[:start] + _scaled(value, constant.name, factor) + source[end:]
    raise CairnError(f"{constant.file} has no constant {constant.name}")


def _offset(source: str, line: int, column: int) -> int:
    lines = source.splitlines(keepends=True)
    before = lines[line - 1].encode()[:column].decode()
    return sum(map(len, lines[: line - 1])) + len(before)


def _scaled(value: ast.expr, name: str, factor: float) -> str:
    """Return an expression for a scaled value: whole numbers stay whole, and at least 1."""
    if isinstance(value, ast.Tuple):
        return f"({', '.join(_scaled(one, name, factor) for one in value.elts)},)"
    text = ast.unparse(value)
    if factor > 1.0 and name in SHARES:
        return f"(0.5 * (1.0 + ({text})))"
    scaled = f"(({text}) * {factor})"
    is_whole = isinstance(value, ast.Constant) and isinstance(value.value, int)
    is_whole = is_whole or text.startswith(("round(", "int(")) or "//" in text
    return f"max(1, round{scaled})" if is_whole else scaled


def drive(name: str, seed: int, goals: int, kidnap_at: int, maps: Path) -> dict[str, Any]:
    """Drive in a simulated world, whose maps are in a folder."""
    world = world_file(name)
    trial = Trial(
        deployment=FOLDER / "sim.yaml",
        world=world,
        map_file=maps / f"{name}.yaml",
        visual_map=maps / f"{name}.cairn",
        start=robot_start(world),
        goals=goals,
        kidnap_at=kidnap_at,
        sets=(),
    )
    run = run_trial(trial, seed)
    return {
        "reached": sum(goal.reached for goal in run.goals),
        "collisions": len(run.collisions),
        "seconds": round(run.simulated_s, 1),
        "error": None if run.error_p95 is None else round(run.error_p95, 4),
    }


def recording(kind: str, robot: int, _maps: Path) -> dict[str, Any]:
    """Replay a recording of MRCLAM with displaced landmarks."""
    result = solve(Case(kind, robot, 0, DATASET, "lr", True, 10, False))
    wrong = {*result.missed, *result.not_registered, *result.lost}
    return {"rmse": round(result.rmse, 4), "wrong": len(wrong)}


def log(_maps: Path) -> dict[str, Any]:
    """Localize on a corrected laser log."""
    recorded = load_log(LOGS["fr101"])
    mapped = mapped_by_stretches(recorded)
    grid = draw_map(recorded, mapped)
    outcome = from_known_start(recorded, grid, np.ones(len(recorded.scans), bool), 0)
    error = outcome.error[~mapped]
    located, _ = starts(recorded, grid, mapped, 0, tries=5)
    return {
        "median": round(float(np.median(error)), 4),
        "off": int(np.sum(error > LOST_M)),
        "located": sum(one < 0.5 for one in located),
    }


def tour(_maps: Path) -> dict[str, Any]:
    """Drive the demo's tour."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "cairn.cli.program", "up", "sim", "--overlay", "demo_tour"]
        command += ["--lockstep", "--plain", "--report", folder]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        file = Path(folder) / "report.json"
        if done.returncode != 0 or not file.exists():
            raise CairnError((done.stdout + done.stderr).splitlines()[-1])
        report = json.loads(file.read_text("utf-8"))
    wrong = sum(
        one["state"] != "live"
        or np.hypot(one["x"] - one["true_x"], one["y"] - one["true_y"]) >= 0.3
        for one in report["objects"]
    )
    return {
        "rmse": round(report["position_rmse_m"], 5),
        "wrong": int(wrong),
        "collisions": len(report["collisions"]),
        "seconds": report["recorded_s"],
    }


_RUN: dict[str, Callable[[Path], dict[str, Any]]] = {
    "hall": partial(drive, "hall", 1, 2, 2),
    "office": partial(drive, "office", 0, 1, 0),
    "displaced": partial(recording, "two", 2),
    "found": partial(recording, "found_one", 5),
    "log": log,
    "tour": tour,
    "mapped_log": lambda _maps: mapped_log(),
    "mapped_drive": lambda _maps: mapped_drive(),
    "mapped_objects": lambda _maps: mapped_objects(),
}


class Copies:
    """Copies of the code, one per job, in which one constant at a time is changed."""

    def __init__(self, folder: Path, number: int) -> None:
        self._free: Queue[Path] = Queue()
        listed = ["git", "ls-files", "-z"]
        names = subprocess.run(listed, cwd=ROOT, capture_output=True, check=True, timeout=60).stdout
        for index in range(number):
            copy = folder / f"copy{index}"
            for name in os.fsdecode(names).split("\0"):
                if name and (ROOT / name).exists():
                    (copy / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(ROOT / name, copy / name, follow_symlinks=False)
            self._free.put(copy)
        self._maps = folder / "maps"
        self._maps.mkdir()
        for name in ("hall", "office"):
            survey(world_file(name), self._maps / f"{name}.yaml", self._maps / f"{name}.cairn")

    @contextmanager
    def _taken(self) -> Iterator[Path]:
        copy = self._free.get()
        try:
            yield copy
        finally:
            self._free.put(copy)

    def run(
        self, scenarios: Sequence[str], constant: Constant | None = None, factor: float = 1.0
    ) -> dict[str, Any]:
        """Return the result of each scenario, or the error of one that failed."""
        with self._taken() as copy:
            if constant is not None:
                original = (ROOT / constant.file).read_text("utf-8")
                changed = changed_source(original, constant, factor)
                (copy / constant.file).write_text(changed, "utf-8")
            try:
                return self._run_in(copy, scenarios)
            finally:
                if constant is not None:
                    shutil.copy2(ROOT / constant.file, copy / constant.file)

    def _run_in(self, copy: Path, scenarios: Sequence[str]) -> dict[str, Any]:
        command = [
            sys.executable,
            "-m",
            "cairn_lab.benchmarks.constants",
            "--maps",
            str(self._maps),
        ]
        try:
            done = subprocess.run(
                [*command, "--run", *scenarios],
                cwd=copy, env={**os.environ, "PYTHONPATH": str(copy)},
                capture_output=True, text=True, timeout=LIMIT_S, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return {"failed": f"not finished within {LIMIT_S:g} s"}
        if done.returncode != 0:
            return {"failed": (done.stderr or done.stdout).strip().splitlines()[-1][:200]}
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return found


def run_here(scenarios: Sequence[str], maps: Path) -> dict[str, Any]:
    """Run scenarios in this process; a run that fails gives its error."""
    found: dict[str, Any] = {}
    for name in scenarios:
        try:
            found[name] = _RUN[name](maps)
        except Exception as error:  # with an unusable value a run may fail in any way
            found[name] = f"failed: {type(error).__name__}: {error}"[:200]
    return found


def read_results() -> dict[str, Any]:
    """Return the recorded results."""
    if not FILE.exists():
        return {"unchanged": {}, "constants": {}}
    found: dict[str, Any] = yaml.safe_load(FILE.read_text("utf-8"))
    return found


def write_results(results: dict[str, Any]) -> None:
    """Write the results, constants in the order of the source."""
    order = {(one.file, one.name): at for at, one in enumerate(constants())}
    entries: dict[str, dict[str, Any]] = {}
    flat = [
        (file, name, entry)
        for file, names in results["constants"].items()
        for name, entry in names.items()
        if (file, name) in order
    ]
    for file, name, entry in sorted(flat, key=lambda one: order[one[0], one[1]]):
        entries.setdefault(file, {})[name] = entry
    text = yaml.safe_dump(
        {"unchanged": results["unchanged"], "constants": entries},
        sort_keys=False, allow_unicode=True, width=200, default_flow_style=None,
    )  # fmt: skip
    FILE.write_text(_HEADER + text, "utf-8")


def chosen_by(only: str) -> list[Constant]:
    """Return the constants whose file and name contain a text."""
    return [one for one in constants() if only in f"{one.file} {one.name}"]


def is_measured(constant: Constant, results: dict[str, Any]) -> bool:
    """Return whether there are results for the present value."""
    entry = results["constants"].get(constant.file, {}).get(constant.name, {})
    return bool(entry.get("value") == constant.source)


def measure_all(only: str, jobs: int, again: bool) -> None:
    """Measure all constants whose file and name contain a text, and record the results."""
    results = read_results()
    chosen = [one for one in chosen_by(only) if again or not is_measured(one, results)]
    with (
        tempfile.TemporaryDirectory(prefix="cairn-constants-") as folder,
        ThreadPoolExecutor(jobs) as pool,
    ):
        copies = Copies(Path(folder), jobs)
        scenarios = sorted({name for one in chosen for name in one.scenarios})
        unchanged = copies.run(scenarios)
        if any(not isinstance(result, dict) for result in unchanged.values()):
            raise CairnError(f"the runs with the present values: {unchanged}")
        results["unchanged"] |= unchanged
        print(yaml.safe_dump(results["unchanged"], default_flow_style=None), flush=True)

        def measure_one(constant: Constant) -> None:
            names = constant.scenarios
            entry: dict[str, Any] = {"value": constant.source}
            for label, factor in (("half", 0.5), ("double", 2.0)):
                found = copies.run(names, constant, factor)
                differing = {
                    name: value
                    for name, value in found.items()
                    if value != results["unchanged"].get(name)
                }
                entry[label] = differing or "same"
            results["constants"].setdefault(constant.file, {})[constant.name] = entry
            write_results(results)
            print(constant.file, constant.name, entry, flush=True)

        for _ in pool.map(measure_one, chosen):
            pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="a part of a file's name or a constant")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--again", action="store_true", help="also what has been measured")
    parser.add_argument("--check", action="store_true", help="list what has not been measured")
    parser.add_argument("--run", choices=_RUN, nargs="+", help="run these here, and print results")
    parser.add_argument("--maps", type=Path, help="folder of the maps, for --run")
    args = parser.parse_args()
    if args.run:
        print(json.dumps(run_here(args.run, args.maps)))
    elif args.check:
        results = read_results()
        left = [one for one in chosen_by(args.only) if not is_measured(one, results)]
        for one in left:
            print(f"{one.file}: {one.name} = {one.source}: not measured; run without --check")
        sys.exit(1 if left else 0)
    else:
        measure_all(args.only, args.jobs, args.again)


if __name__ == "__main__":
    main()
