"""Surveys a world, and runs a deployment with an examiner in it in lockstep."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from cairn import CairnError
from cairn.components.map_builder.importing import alter
from cairn.components.simulation.survey import surveyed_grid, surveyed_models, surveyed_objects
from cairn.components.simulation.world_file import Event, read_world
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.planar.map_file import read_map as read_grid
from cairn.planar.map_file import write_map as write_grid
from cairn.planar.poses import Pose
from cairn.visual_map.new_map import write_map
from cairn_lab.batch.packing import pack_deployment
from cairn_lab.batch.runner import Outcome, run_task_here
from cairn_lab.batch.task import Task
from cairn_lab.evaluation.map_comparison import (
    ROBOT_RADIUS_M,
    WALL_M,
    compare_with_world,
    placed_map,
)
from cairn_lab.evaluation.results import RunResult

_POSE = ("x", "y", "theta")
_RESULT = "result.json"


@dataclass(frozen=True)
class Trial:
    """What a run is but for its seed: deployment, world, maps, the robot's start pose, goals."""

    deployment: Path
    world: Path
    map_file: Path
    visual_map: Path
    start: Pose
    goals: int
    kidnap_at: int
    sets: tuple[str, ...]


def survey(world: Path, map_file: Path, visual_map: Path) -> None:
    """Write the grid map and the visual map of a world as it is at the beginning."""
    write_grid(map_file, surveyed_grid(world))
    objects = alter(surveyed_objects(world), {}, ())
    source = f"surveyed of {world.name}"
    # Without the time of creation: equal worlds have equal maps, so their runs are in the cache.
    write_map(visual_map, source, objects, models=surveyed_models(world), created_s=0.0)


def align(made: Path, world: Path, file: Path) -> str:
    """Write a map that a robot has made in the frame of the world; return how well it agrees.

    Its own frame is that of the world, or that of the robot at its start, whichever agrees better.
    """
    grid = read_grid(made)
    compared = [
        compare_with_world(grid, world, frame, ROBOT_RADIUS_M)
        for frame in ((0.0, 0.0, 0.0), robot_start(world))
    ]
    best = max(compared, key=lambda one: one.within(WALL_M))
    write_grid(file, placed_map(grid, best.pose))
    x, y, theta = best.pose
    return (
        f"{made}: its frame is at ({x:.2f} m, {y:.2f} m, {theta:.3f} rad) in the world; "
        f"{best.within(WALL_M):.1%} of its walls are within {100 * WALL_M:g} cm of the world's, "
        f"{best.known:.1%} of the reachable area is known"
    )


def robot_start(world: Path) -> Pose:
    """Return the robot's pose at the beginning, from the world file."""
    return read_world(world).robot.pose


def scripted_events(world: Path, deployment: Deployment) -> dict[str, float]:
    """Return the time [s] of each event of the world file and the deployment, by its name."""
    events = list(read_world(world).events)
    for member in deployment.members():
        if member.spec.plugin == "simulated_world":
            more = member.spec.parameters.get("events", ())
            events += [Event.model_validate(event) for event in more]
    return {_event_name(event): event.at for event in sorted(events, key=lambda event: event.at)}


def trial_tasks(examined: Deployment, folder: Path, seeds: Sequence[int]) -> list[Task]:
    """Return a task for each seed, of the `examination` in `folder`.

    Raises `CairnError` if a file of the deployment cannot be read.
    """
    packed = pack_deployment(examined, folder)
    return [Task(f"seed {seed}", packed, seed, (_RESULT,)) for seed in seeds]


def run_result(task: Task, outcome: Outcome) -> RunResult:
    """Return what the examiner of a run has found, or why it has found nothing."""
    result, failure = outcome.result, outcome.failure
    if result is not None and not failure:
        if result.normal and _RESULT in result.files:
            found = RunResult.model_validate_json(result.files[_RESULT])
            return found.model_copy(update={"seed": task.seed})
        failure = result.reason
    return RunResult(seed=task.seed, failure=task.packed.with_origins(failure))


def run_trial(trial: Trial, seed: int) -> RunResult:
    """Run a trial in this process; raise `CairnError` if it is not valid."""
    with TemporaryDirectory() as folder:
        report = Path(folder)
        (task,) = trial_tasks(examination(trial, report), report, [seed])
        run = run_result(task, run_task_here(task))
    if run.failure:
        raise CairnError(run.failure)
    return run


def examination(trial: Trial, folder: Path) -> Deployment:
    """Return the deployment with an examiner; `folder` is for files."""
    overlay = folder / "examination.yaml"
    overlay.write_text(_overlay(trial, folder / _RESULT), encoding="utf-8")
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
    """Return YAML that adds the examiner and loads AutoMove's plugins before the first goal."""
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


def _event_name(event: Event) -> str:
    person, added = event.add_person, event.add_furniture or event.add_object
    targets = {
        "move": event.move,
        "remove": event.remove,
        "swap": event.swap and " and ".join(event.swap),
        "add": person.name if person else added and added.display_name,
    }
    action = next((f"{verb} {name}" for verb, name in targets.items() if name), "kidnap")
    return f"{action} at {event.at:g} s"
