"""`cairn evaluate navigation`, as a user runs it: goals reached in the room, and a report."""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from cairn.tools.evaluation import cli
from cairn.tools.evaluation.results import GoalResult, RunResult
from cairn.tools.evaluation.runs import Trial, examination
from tests.commands import Answer, cairn

pytestmark = pytest.mark.processes


ROOT = Path(__file__).parents[4]


def test_a_robot_reaches_its_goals_though_it_is_carried_off(tmp_path: Path) -> None:
    answer = cairn(
        "evaluate",
        "navigation",
        "--world",
        str(ROOT / "deploy" / "worlds" / "room.yaml"),
        "--deployment",
        str(ROOT / "deploy" / "sim.yaml"),
        "--goals",
        "2",
        "--seeds",
        "3",
        "--kidnap",
        "--out",
        str(tmp_path / "out"),
        "--json",
    )

    assert answer.code == 0, answer
    summary = json.loads(answer.out)["summary"]
    assert (summary["goals"], summary["reached"], summary["collisions"]) == (2, 2, 0)
    assert (summary["kidnapped"], summary["kidnapped_reached"]) == (1, 1)
    runs = json.loads((tmp_path / "out" / "runs.json").read_text())["runs"]
    assert runs[0]["seed"] == 3
    assert runs[0]["error_median"] < 0.05
    assert summary["relocalized"] == 1
    assert summary["end_error_p95"] < 0.15
    for goal in runs[0]["goals"]:
        assert goal["shortest"] >= 1.5
        assert goal["driven"] >= 0.95 * goal["shortest"]
    for picture in ("tracks.png", "ways.png"):
        assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")


def test_a_world_that_cannot_be_is_told_of(tmp_path: Path) -> None:
    world = tmp_path / "world.yaml"
    world.write_text(
        "walls: [{points: [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]}]\n"
        "furniture:\n"
        "  - {name: table, x: 2, y: 2, size: [1, 1]}\n"
        "  - {name: desk, x: 2.4, y: 2, size: [1, 1]}\n"
        "robot: {x: 1, y: 1}\n"
    )

    answer = cairn(
        "evaluate",
        "navigation",
        "--world",
        str(world),
        "--deployment",
        str(ROOT / "deploy" / "sim.yaml"),
        "--out",
        str(tmp_path / "out"),
    )

    assert answer.code == 1
    assert "desk overlaps table at (2.20, 2.00); move one of them" in answer.err


GOOD = GoalResult(
    x=3.0, y=2.0, theta=0.0, reached=True, claimed=True, reason="arrived", shortest=2.0,
    driven=2.1, seconds=6.0, recoveries=0, end_error=0.02, end_turn=0.01,
)  # fmt: skip
MISSED = GOOD.model_copy(update={"reached": False, "end_error": 0.3})


def trial(*sets: str) -> Trial:
    return Trial(
        deployment=ROOT / "deploy" / "sim.yaml",
        world=ROOT / "deploy" / "worlds" / "room.yaml",
        map_file=ROOT / "deploy" / "maps" / "room.yaml",
        visual_map=ROOT / "deploy" / "maps" / "room.cairn",
        start=(2.0, 1.5, 0.3),
        goals=4,
        seed=1,
        kidnap_at=0,
        sets=sets,
    )


@pytest.fixture
def runs_as_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that are not driven, for what is made of them; on a thread, which begins at once."""
    monkeypatch.setattr(cli, "run_trial", as_told)
    monkeypatch.setattr(cli, "worker_pool", ThreadPoolExecutor)


@pytest.fixture
def empty_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A world without objects, so that none of their pictures are surveyed."""
    world = tmp_path_factory.mktemp("world") / "room.yaml"
    world.write_text(
        "walls: [{points: [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]}]\nrobot: {x: 1, y: 1}\n"
    )
    return world


def as_told(trial: Trial, scratch: str, logs: Path) -> RunResult:
    """A run by the number of its seed."""
    if trial.seed == 9:
        raise ValueError("this seed went wrong")
    return {
        0: RunResult(seed=0, goals=[GOOD], track=[(1.0, 1.0), (3.0, 2.0)], simulated_s=60.0),
        1: RunResult(seed=1, goals=[GOOD, MISSED], simulated_s=40.0),
        2: RunResult(seed=2, goals=[GOOD], collisions=["table at (1.00, 1.00), 0.20 m/s"]),
        3: RunResult(seed=3, goals=[GOOD], failure="never carried off"),
    }[trial.seed]


@pytest.mark.usefixtures("runs_as_told")
@pytest.mark.parametrize(
    ("seeds", "code", "told"),
    [
        ("0", 0, "reached           1 of 1"),
        ("0..1", 1, "seed 1, goal 2 at (3.00, 2.00) not reached"),
        ("2", 1, "seed 2, collision: table"),
        ("3", 1, "seed 3 failed: never carried off"),
        ("9", 1, "seed 9 failed: ValueError('this seed went wrong')"),
    ],
)
def test_its_exit_status_tells_whether_all_went_well(
    tmp_path: Path, empty_room: Path, seeds: str, code: int, told: str
) -> None:
    answer = evaluated(tmp_path / "out", *SIM, "--seeds", seeds, world=empty_room)

    assert answer.code == code, answer
    assert told in answer.out


def evaluated(out: Path, *arguments: str, world: Path = ROOT / "deploy/worlds/room.yaml") -> Answer:
    """The answer to an evaluation of one run at a time."""
    return cairn(
        "evaluate", "navigation", "--world", str(world), "--out", str(out), "--workers", "1",
        *arguments,
    )  # fmt: skip


SIM = ("--deployment", str(ROOT / "deploy" / "sim.yaml"))


def a_file(folder: Path) -> Path:
    (folder / "file").touch()
    return folder / "file"


def a_folder_with_a_file_called_logs(folder: Path) -> Path:
    (folder / "logs").touch()
    return folder


@pytest.mark.usefixtures("runs_as_told")
@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (a_file, "Not a directory"),
        (a_folder_with_a_file_called_logs, "File exists"),
        (lambda _: Path("/proc/evaluation"), "No such file or directory"),
    ],
)
def test_a_folder_that_cannot_be_written_is_told_of_before_any_run(
    tmp_path: Path, make: Callable[[Path], Path], cause: str
) -> None:
    out = make(tmp_path)

    answer = evaluated(out, *SIM)

    assert (answer.code, answer.out) == (1, "")
    assert answer.err.startswith(f"cairn: the report's folder {out} cannot be written: ")
    assert f"{cause}; name another one with --out" in answer.err
    assert len(answer.err.splitlines()) == 1


@pytest.mark.usefixtures("runs_as_told")
def test_a_report_that_cannot_be_written_in_the_end_is_told_of(
    tmp_path: Path, empty_room: Path
) -> None:
    (tmp_path / "runs.json").mkdir()

    answer = evaluated(tmp_path, *SIM, "--seeds", "0", "--json", world=empty_room)

    assert (answer.code, answer.out) == (1, "")
    assert f"folder {tmp_path} cannot be written: {tmp_path}/runs.json: Is a dir" in answer.err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--deployment", "nope.yaml"), "name yours with --deployment FILE"),
        ((*SIM, "--set", "components.bas.parameters.x=3"), "there is no component bas; did you"),
    ],
)
def test_a_deployment_that_cannot_start_is_told_of_once_before_any_run(
    tmp_path: Path, arguments: tuple[str, ...], told: str
) -> None:
    answer = evaluated(tmp_path / "out", *arguments)

    assert (answer.code, answer.out) == (1, "")
    assert answer.err.count(told) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("runs_as_told")
def test_its_json_tells_why_runs_failed(tmp_path: Path, empty_room: Path) -> None:
    answer = evaluated(tmp_path, *SIM, "--seeds", "2..3", "--json", world=empty_room)

    assert answer.code == 1
    assert answer.json["summary"]["failures"] == {"3": "never carried off"}


@pytest.mark.usefixtures("runs_as_told")
def test_events_that_came_due_after_the_end_of_a_run_are_told(
    tmp_path: Path,
) -> None:
    world = tmp_path / "world.yaml"
    room = ROOT / "deploy" / "worlds" / "room.yaml"
    world.write_text(
        room.read_text().replace("textures/", f"{room.parent}/textures/")
        + "events:\n"
        + "  - {at: 90, kidnap: {x: 2, y: 2}}\n"
        + "  - {at: 50, swap: [object_1, object_2]}\n"
        + "  - {at: 10, remove: crate}\n"
    )
    more = "[{at: 60, add_person: {name: visitor, waypoints: [[6, 2]]}}]"
    sets = ("--set", f"components.world.parameters.events={more}")

    answer = evaluated(tmp_path, *SIM, *sets, "--seeds", "0..1", world=world)

    assert (
        '  events            1 of 4 came due in every run; "swap object_1 and object_2 at 50 s" '
        'in 1 of 2; "add visitor at 60 s" in 1 of 2; "kidnap at 90 s" in none\n'
    ) in answer.out, answer
    assert json.loads((tmp_path / "runs.json").read_text())["summary"]["events"] == {
        "remove crate at 10 s": 2,
        "swap object_1 and object_2 at 50 s": 1,
        "add visitor at 60 s": 1,
        "kidnap at 90 s": 0,
    }


def test_a_run_that_fails_does_not_lose_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials = [replace(trial(), seed=seed) for seed in (0, 9, 1)]
    monkeypatch.setattr(cli, "run_trial", as_told)

    runs = cli._run(trials, tmp_path, 1, quiet=True)

    assert [(run.seed, len(run.goals)) for run in runs] == [(0, 1), (9, 0), (1, 2)]
    assert [bool(run.failure) for run in runs] == [False, True, False]


def test_the_examiner_measures_for_the_robot_that_drives(tmp_path: Path) -> None:
    found = examination(trial("settings.radius=0.3"), tmp_path, tmp_path / "result.json")

    assert found.components["examiner"].parameters["radius"] == 0.3
    assert found.components["world"].parameters["radius"] == 0.3


def test_the_robot_starts_where_the_world_has_it(tmp_path: Path) -> None:
    found = examination(trial(), tmp_path, tmp_path / "result.json")

    automove = found.components["mobile_supervisor"].children["automove"]
    start = automove.children["localizer"].parameters["start"]
    assert start == {"x": 2.0, "y": 1.5, "theta": 0.3}
