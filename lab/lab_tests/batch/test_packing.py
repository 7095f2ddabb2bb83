"""A task is complete in itself, and its key depends on what its result depends on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.deployment.load import load_deployment
from cairn_lab.batch import packing
from cairn_lab.batch.packing import pack_deployment
from cairn_lab.batch.runner import run_task_here
from cairn_lab.batch.task import Task, TaskResult
from cairn_lab.evaluation.runs import Trial, examination, robot_start, survey, trial_tasks
from lab_tests.batch.clerks import OUTPUT, clerk_tasks

ROOT = Path(__file__).parents[3]
TEXTURES = ROOT / "deploy" / "worlds" / "textures"


def result_of(task: Task) -> TaskResult:
    result = run_task_here(task).result
    assert result is not None
    return result


@pytest.mark.accuracy
@pytest.mark.slow
def test_run_needs_no_file_of_the_computer_that_submits_it(tmp_path: Path) -> None:
    project = tmp_path / "project"
    (project / "worlds").mkdir(parents=True)
    (project / "pictures").mkdir()
    shutil.copy(TEXTURES / "box.jpg", project / "pictures")
    shutil.copy(TEXTURES / "aloe.jpg", project / "pictures")
    world = project / "worlds" / "cell.yaml"
    world.write_text(
        "walls: [{points: [[0, 0], [6, 0], [6, 4], [0, 4], [0, 0]]}]\n"
        "objects:\n"
        "  - {id: 1, x: 0, y: 2, texture: ../pictures/box.jpg}\n"
        f"  - {{id: 2, x: 6, y: 2, theta: 3.14, texture: '{project}/pictures/aloe.jpg'}}\n"
        "robot: {x: 1, y: 1}\n"
    )
    picture = "{id: 3, x: 3, y: 0, theta: 1.57, texture: ../pictures/box.jpg}"
    event = f"components.world.parameters.events=[{{at: 1, add_object: {picture}}}]"
    survey(world, project / "map.yaml", project / "map.cairn")
    trial = Trial(
        deployment=ROOT / "deploy" / "sim.yaml", world=world, map_file=project / "map.yaml",
        visual_map=project / "map.cairn", start=robot_start(world), goals=1, kidnap_at=0,
        sets=(event,),
    )  # fmt: skip
    (tmp_path / "scratch").mkdir()
    (task,) = trial_tasks(examination(trial, tmp_path / "scratch"), tmp_path / "scratch", [5])
    shutil.rmtree(project)

    result = result_of(task)

    assert (result.normal, result.error) == (True, "")
    assert json.loads(result.files["result.json"])["goals"][0]["reached"]
    assert str(project) not in task.packed.document


def test_key_depends_on_all_that_decides_the_result_and_on_nothing_else(tmp_path: Path) -> None:
    (task,) = clerk_tasks(tmp_path / "project", [1])
    keys = {
        "again": clerk_tasks(tmp_path / "project", [1])[0].key,
        "elsewhere": clerk_tasks(tmp_path / "other", [1])[0].key,
        "name": replace(task, name="first").key,
    }
    others = {
        "seed": replace(task, seed=2).key,
        "parameter": clerk_tasks(tmp_path / "project", [1], "steps=3")[0].key,
        "replaced": replace(task, parameters={"clerk": {"steps": 3}}).key,
        "outputs": replace(task, outputs=()).key,
        "code": replace(task, packed=replace(task.packed, code={"numpy": "1.0"})).key,
        "file": replace(task, packed=replace(task.packed, files={"files/0/source.txt": "0"})).key,
    }

    assert set(keys.values()) == {task.key}
    assert len({task.key, *others.values()}) == 1 + len(others)


def test_parameters_of_a_task_replace_those_of_the_deployment(tmp_path: Path) -> None:
    (task,) = clerk_tasks(tmp_path / "project", [1])

    longer = result_of(replace(task, parameters={"clerk": {"steps": 5}}))

    assert len(longer.files[OUTPUT].splitlines()) == 5


def test_result_names_no_folder_of_the_worker_and_messages_those_of_the_user(
    tmp_path: Path,
) -> None:
    (task,) = clerk_tasks(tmp_path / "project", [1], f"source={tmp_path}/absent.txt")

    result = result_of(task)

    assert "cairn-task-" not in result.reason + result.files["log.txt"].decode()
    assert f"'{tmp_path}/absent.txt'" in task.packed.with_origins(result.reason)


def test_exception_of_a_run_is_its_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (task,) = clerk_tasks(tmp_path / "project", [1])

    def fail(*_: object) -> None:
        raise MemoryError("too little")

    monkeypatch.setattr("cairn_lab.batch.worker.LockstepRun", fail)

    assert result_of(task).error == "MemoryError('too little')"


def huge_file(folder: Path) -> None:
    with (folder / "source.txt").open("wb") as stream:
        stream.truncate(300 << 20)


def folder_with_many_files(folder: Path) -> None:
    (folder / "source.txt").unlink()
    (folder / "source.txt").mkdir()
    for number in range(5):
        (folder / "source.txt" / f"{number}").touch()


@pytest.mark.parametrize(
    ("make", "message"),
    [(huge_file, "more than the 268 MB"), (folder_with_many_files, "5 files, more than the 4")],
)
def test_files_of_a_task_are_limited(
    tmp_path: Path, make: Callable[[Path], None], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packing, "MOST_FILES", 4)
    clerk_tasks(tmp_path, [1])
    make(tmp_path)
    deployment = load_deployment(tmp_path / "clerk.yaml")

    with pytest.raises(CairnError, match=message):
        pack_deployment(deployment, tmp_path / "report")


@pytest.mark.parametrize("name", ["../outside", "/etc/outside", "a/../../outside"])
def test_worker_writes_below_its_folder_only(tmp_path: Path, name: str) -> None:
    (task,) = clerk_tasks(tmp_path, [1])
    (digest,) = task.packed.files.values()
    hostile = replace(task, packed=replace(task.packed, files={name: digest}))

    with pytest.raises(ValueError, match="leads out of the folder"):
        result_of(hostile)
