"""One run of an evaluation: a deployment in lockstep with an examiner in it."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path

from cairn import CairnError
from cairn.cli.runs import log_file
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.placement.lockstep import LockstepRun
from cairn.planar.poses import Pose
from cairn.tools.evaluation.results import RunResult

_POSE = ("x", "y", "theta")


@dataclass(frozen=True)
class Trial:
    """What is run: deployment, world, its maps, where the robot starts, and the examination."""

    deployment: Path
    world: Path
    map_file: Path
    visual_map: Path
    start: Pose
    goals: int
    seed: int
    kidnap_at: int
    sets: tuple[str, ...]


def run_trial(trial: Trial, scratch: str, logs: Path) -> RunResult:
    """Run it, with its log in the folder `logs`; raises `CairnError` if the deployment fails."""
    folder = Path(scratch) / f"seed-{trial.seed}"
    folder.mkdir()
    logging.getLogger("cairn").propagate = False  # a run's failures are in its log and its result
    result = folder / "result.json"
    run = LockstepRun(examination(trial, folder, result), trial.seed)
    with log_file(logs / f"seed-{trial.seed}.log", run.executor.now):
        end = run.run(lambda: None)
    if not end.normal or not result.exists():
        raise CairnError(end.reason)
    found = RunResult.model_validate_json(result.read_text(encoding="utf-8"))
    return found.model_copy(update={"seed": trial.seed})


def examination(trial: Trial, folder: Path, result: Path) -> Deployment:
    """The deployment with an examiner in it, which writes the result; `folder` is for files."""
    overlay = folder / "examination.yaml"
    overlay.write_text(_overlay(trial, result), encoding="utf-8")
    return load_deployment(
        trial.deployment,
        [overlay],
        [
            f"settings.world={trial.world}",
            f"settings.map={trial.map_file}",
            f"settings.visual_map={trial.visual_map}",
            f"settings.report={folder}",
            f"settings.start={json.dumps(dict(zip(_POSE, trial.start, strict=True)))}",
            *trial.sets,
        ],
    )


def _overlay(trial: Trial, result: Path) -> str:
    """The examiner, and AutoMove's plugins loaded before the first order: YAML, as JSON is."""
    examiner = {
        "plugin": "navigation_examiner",
        "restart": "transient",
        "significant": True,
        "parameters": {
            "goals": trial.goals,
            "kidnap_at": trial.kidnap_at,
            "radius": "${radius}",
            "file": str(result),
        },
    }
    automove = {"load": "at_start", "parameters": {"load_plugins": "on_activation"}}
    supervisor = {"significant": False, "children": {"automove": automove}}
    return json.dumps(
        {"components": {"mobile_supervisor": supervisor, "examiner": examiner}}, indent=1
    )
