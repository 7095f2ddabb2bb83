"""One run of an evaluation: a deployment in lockstep with an examiner in it."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path

import yaml

from cairn.deployment.load import load_deployment
from cairn.errors import CairnError
from cairn.placement.lockstep_run import LockstepRun
from components.evaluation.results import RunResult


@dataclass(frozen=True)
class Trial:
    """What is run: deployment, world and its maps, and the examination."""

    deployment: Path
    world: Path
    map_file: Path
    visual_map: Path
    goals: int
    seed: int
    kidnap_at: int
    sets: tuple[str, ...]


def run_trial(trial: Trial, scratch: str) -> RunResult:
    """Run it; raises `CairnError` if the deployment fails."""
    folder = Path(scratch) / f"seed-{trial.seed}"
    folder.mkdir()
    logging.getLogger("cairn").setLevel(logging.CRITICAL)  # failures are in the result
    result = folder / "result.json"
    overlay = folder / "examination.yaml"
    overlay.write_text(_overlay(trial, result), encoding="utf-8")
    deployment = load_deployment(
        trial.deployment,
        [overlay],
        [
            f"settings.world={trial.world}",
            f"settings.map={trial.map_file}",
            f"settings.visual_map={trial.visual_map}",
            f"settings.report={folder}",
            f"settings.start={_start(trial.world)}",
            *trial.sets,
        ],
    )
    end = LockstepRun(deployment, trial.seed).run(lambda: None)
    if not end.normal or not result.exists():
        raise CairnError(f"the run of seed {trial.seed} failed: {end.reason}")
    found = RunResult.model_validate_json(result.read_text(encoding="utf-8"))
    return found.model_copy(update={"seed": trial.seed})


def _start(world: Path) -> str:
    """Where the world file puts the robot: the start that it knows."""
    robot = yaml.safe_load(world.read_text(encoding="utf-8"))["robot"]
    start = {"x": robot["x"], "y": robot["y"], "theta": robot.get("theta", 0.0)}
    return json.dumps(start)


def _overlay(trial: Trial, result: Path) -> str:
    """The examiner, and AutoMove's plugins loaded before the first order: YAML, as JSON is."""
    examiner = {
        "plugin": "navigation_examiner",
        "restart": "transient",
        "significant": True,
        "parameters": {
            "goals": trial.goals,
            "kidnap_at": trial.kidnap_at,
            "file": str(result),
        },
    }
    automove = {"load": "at_start", "parameters": {"load_plugins": "on_activation"}}
    supervisor = {"significant": False, "children": {"automove": automove}}
    return json.dumps(
        {"components": {"mobile_supervisor": supervisor, "examiner": examiner}}, indent=1
    )
