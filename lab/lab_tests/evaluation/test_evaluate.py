"""`cairn evaluate navigation`, as a user runs it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from cairn_lab.batch.options import BatchOptions
from cairn_lab.batch.task import LOG, TaskResult
from cairn_lab.evaluation.results import GoalResult, RunResult
from cairn_lab.evaluation.runs import Trial, examination
from lab_tests.batch.fake_workers import FakeWorkers, Payload, answer
from tests.commands import Answer, cairn
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = pytest.mark.processes


ROOT = Path(__file__).parents[3]


@pytest.mark.accuracy
def test_kidnapped_robot_reaches_its_goals(tmp_path: Path) -> None:
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
        "--no-cache",
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
    for picture in ("tracks.png", "paths.png"):
        assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")


def test_impossible_world_is_rejected(tmp_path: Path) -> None:
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
    assert_words(answer.err, "desk", "table", "(2.20, 2.00)", "move")


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
        kidnap_at=0,
        sets=sets,
    )


@pytest.fixture
def scripted_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace runs by prepared results."""
    monkeypatch.setattr(BatchOptions, "open_workers", lambda *_: FakeWorkers(scripted_run))
    monkeypatch.setattr(BatchOptions, "open_cache", lambda _: None)


@pytest.fixture
def empty_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A world without objects: none of their pictures are surveyed."""
    world = tmp_path_factory.mktemp("world") / "room.yaml"
    world.write_text(
        "walls: [{points: [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]}]\nrobot: {x: 1, y: 1}\n"
    )
    return world


def scripted_run(task: Payload, _contents: object, _worker: str) -> dict[str, object]:
    """Return the prepared result of a seed."""
    if task["seed"] == 4:
        error = "ValueError('this seed went wrong')"
        return answer(TaskResult(False, False, error, {LOG: b"until then\n"}, error))
    run = {
        0: RunResult(seed=0, goals=[GOOD], track=[(1.0, 1.0), (3.0, 2.0)], simulated_s=60.0),
        1: RunResult(seed=1, goals=[GOOD, MISSED], simulated_s=40.0),
        2: RunResult(seed=2, goals=[GOOD], collisions=["table at (1.00, 1.00), 0.20 m/s"]),
        3: RunResult(seed=3, goals=[GOOD], failure="never kidnapped"),
        5: RunResult(seed=5, goals=[GOOD]),
    }[task["seed"]]
    files = {"result.json": run.model_dump_json().encode(), LOG: b"all of it\n"}
    return answer(TaskResult(True, True, "", files))


@pytest.mark.usefixtures("scripted_runs")
@pytest.mark.parametrize(
    ("seeds", "code", "expected"),
    sampled(
        [
            ("0", 0, "reached           1 of 1"),
            ("0..1", 1, "seed 1, goal 2 at (3.00, 2.00) not reached"),
            ("2", 1, "seed 2, collision: table"),
            ("3", 1, "seed 3 failed: never kidnapped"),
            ("4", 1, "seed 4 failed: ValueError('this seed went wrong')"),
        ],
        2,
    ),
)
def test_exit_status_reports_failures(
    tmp_path: Path, empty_room: Path, seeds: str, code: int, expected: str
) -> None:
    answer = evaluated(tmp_path / "out", *SIM, "--seeds", seeds, world=empty_room)

    assert answer.code == code, answer
    assert expected in answer.out


def evaluated(out: Path, *arguments: str, world: Path = ROOT / "deploy/worlds/room.yaml") -> Answer:
    """Run the command with one worker."""
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


@pytest.mark.usefixtures("scripted_runs")
@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (a_file, "Not a directory"),
        (a_folder_with_a_file_called_logs, "File exists"),
        (lambda _: Path("/proc/evaluation"), "No such file or directory"),
    ],
)
def test_unwritable_folder_is_reported_before_any_run(
    tmp_path: Path, make: Callable[[Path], Path], cause: str
) -> None:
    out = make(tmp_path)

    answer = evaluated(out, *SIM)

    assert (answer.code, answer.out) == (1, "")
    assert answer.err.startswith(f"cairn: the report's folder {out} cannot be written: ")
    assert f"{cause}; name another one with --out" in answer.err
    assert len(answer.err.splitlines()) == 1


@pytest.mark.usefixtures("scripted_runs")
def test_unwritable_report_is_an_error(tmp_path: Path, empty_room: Path) -> None:
    (tmp_path / "runs.json").mkdir()

    answer = evaluated(tmp_path, *SIM, "--seeds", "0", "--json", world=empty_room)

    assert (answer.code, answer.out) == (1, "")
    assert f"folder {tmp_path} cannot be written: {tmp_path}/runs.json: Is a dir" in answer.err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--deployment", "nope.yaml"), "name yours with --deployment FILE"),
        ((*SIM, "--set", "components.bas.parameters.x=3"), "there is no component bas; did you"),
    ],
)
def test_invalid_deployment_is_reported_once_before_any_run(
    tmp_path: Path, arguments: tuple[str, ...], expected: str
) -> None:
    answer = evaluated(tmp_path / "out", *arguments)

    assert (answer.code, answer.out) == (1, "")
    assert answer.err.count(expected) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("scripted_runs")
def test_json_output_contains_failures(tmp_path: Path, empty_room: Path) -> None:
    answer = evaluated(tmp_path, *SIM, "--seeds", "2..3", "--json", world=empty_room)

    assert answer.code == 1
    assert answer.json["summary"]["failures"] == {"3": "never kidnapped"}


@pytest.mark.accuracy
@pytest.mark.usefixtures("scripted_runs")
def test_events_after_the_end_of_a_run_are_reported(
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


@pytest.mark.usefixtures("scripted_runs")
def test_failed_run_keeps_the_results_and_logs_of_the_others(
    tmp_path: Path, empty_room: Path
) -> None:
    answer = evaluated(tmp_path, *SIM, "--seeds", "3..5", world=empty_room)

    assert answer.code == 1, answer
    assert [text.partition(":")[0] for text in answer.err.splitlines()] == [
        "seed 3",
        "seed 4",
        "seed 5",
    ]
    runs = json.loads((tmp_path / "runs.json").read_text())["runs"]
    assert [(run["seed"], len(run["goals"])) for run in runs] == [(3, 1), (4, 0), (5, 1)]
    logs = [(tmp_path / "logs" / f"seed-{seed}.log").read_text() for seed in (3, 4, 5)]
    assert logs == ["all of it\n", "until then\n", "all of it\n"]


def test_examiner_uses_the_radius_of_the_deployment(tmp_path: Path) -> None:
    found = examination(trial("robot.shape.radius_m=0.3"), tmp_path)

    assert found.components["examiner"].parameters["radius"] == 0.3
    assert found.components["world"].parameters["radius"] == 0.3


def test_robot_starts_at_the_pose_of_the_world_file(tmp_path: Path) -> None:
    found = examination(trial(), tmp_path)

    automove = found.components["mobile_supervisor"].children["automove"]
    start = automove.children["localizer"].parameters["start"]
    assert start == {"x": 2.0, "y": 1.5, "theta": 0.3}
