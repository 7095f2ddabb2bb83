"""`cairn experiment`, as a user runs it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from cairn_lab.batch.options import BatchOptions
from cairn_lab.experiments import ablation
from cairn_lab.experiments.random_changes import RandomChanges
from cairn_lab.experiments.series import read_method, read_world
from lab_tests.batch.fake_workers import FakeWorkers, run_here
from tests.commands import Answer, cairn
from tests.wording import assert_words

pytestmark = pytest.mark.processes


DEPLOY = Path(__file__).parents[3] / "deploy"
# Near objects 8 and 9.
TOUR = "settings.mission=[[4.6, 1.6, -1.0]]"


@pytest.fixture(autouse=True, scope="module")
def candidate_poses_once() -> Iterator[None]:
    """The candidate poses for moved objects take seconds to find, and are always the same."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ablation, "RandomChanges", cache(RandomChanges))
        yield


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run one by one in this process, at once; the ablation's test starts processes."""
    monkeypatch.setattr(BatchOptions, "open_workers", lambda *_: FakeWorkers(run_here))


def experiment(command: str, out: Path, *options: str) -> Answer:
    return cairn(
        "experiment",
        command,
        "--deployment",
        str(DEPLOY / "sim.yaml"),
        "--overlay",
        str(DEPLOY / "experiment.yaml"),
        "--driver",
        "geometric",
        "--set",
        TOUR,
        "--out",
        str(out),
        "--no-cache",
        *options,
    )


@pytest.mark.accuracy
def test_ablation_compares_all_methods_on_the_same_data(tmp_path: Path) -> None:
    answer = experiment("ablation", tmp_path, "--seeds", "0", "--at", "6", "--moved", "2")

    assert answer.code == 0, answer
    assert "1 of 1: runs/seed-0 done" in answer.err
    for title in ("ours (likelihood ratio)", "paper, clamped", "persistence filter", "no update"):
        assert title in answer.out
    assert_words(answer.out, "1 run", "too few")
    assert_words(answer.out, "none", "only 1 run")
    report = json.loads((tmp_path / "report.json").read_text())
    assert (tmp_path / "report.txt").read_text().splitlines()[0] in answer.out
    assert [one["method"] for one in report["summary"]] == [
        "ours",
        "paper_rule",
        "paper",
        "chi_square",
        "persistence",
        "no_update",
    ]
    (run,) = report["runs"]
    assert [move["moved_at"] for move in run["methods"][0]["moves"]] == [6.0, 6.0]
    assert report["about"]["MethodSummary"]["recall"].startswith("Moved objects that were removed,")
    assert (tmp_path / "ablation.png").read_bytes().startswith(b"\x89PNG")
    folder = tmp_path / "runs" / "seed-0"
    assert len(read_world(folder / "world.jsonl").moves) == 2
    last = [read_method(folder / f"{one['method']}.jsonl").stamps[-1] for one in report["summary"]]
    assert max(last) - min(last) < 0.2


@pytest.mark.accuracy
@pytest.mark.usefixtures("in_this_process")
def test_both_runs_of_a_seed_are_identical_to_the_last_bit_until_the_change(
    tmp_path: Path,
) -> None:
    """Both runs of a seed follow the same path: only the change causes differences."""
    event = "components.world.parameters.events=[{at: 6, move: object_9, to: {x: 9, y: 1.9}}]"
    answer = experiment("uncertainty", tmp_path, "--seeds", "1", "--set", event, "--json")

    assert answer.code == 0, answer
    report = (tmp_path / "report.txt").read_text()
    assert report.count("In 0 of 1 seed the moved object was registered again") == 2  # filters
    figures = {
        (one["condition"], one["phase"], one["quantity"]): one["against_unchanged"]["mean"]
        for one in answer.json["summary"]
    }
    for condition in ("changed", "changed_fixed"):
        for quantity in ("position_spread", "position_sigma", "position_error"):
            assert figures[condition, "before", quantity] == 1.0
    for picture in ("fig9_position.png", "fig9_orientation.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    unchanged, changed = (
        read_world(tmp_path / "runs" / "seed-1" / name / "world.jsonl")
        for name in ("unchanged", "changed")
    )
    assert (unchanged.poses == changed.poses).all()
    assert not unchanged.moves
    assert len(changed.moves) == 1


@pytest.mark.accuracy
@pytest.mark.usefixtures("in_this_process")
def test_map_update_draws_its_maps(tmp_path: Path) -> None:
    pose = "{x: 4.7, y: 0, theta: 1.5708}"
    event = f"components.world.parameters.events=[{{at: 6, move: object_8, to: {pose}}}]"
    answer = experiment("map-update", tmp_path, "--seeds", "0", "--set", event)

    assert answer.code == 0, answer
    assert "ours (likelihood ratio), run by run:" in answer.out
    for picture in ("maps_a_h.png", "reliability.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("in_this_process")
def test_failed_runs_are_reported_and_exit_with_status_1(tmp_path: Path) -> None:
    answer = experiment(
        "map-update",
        tmp_path,
        "--seeds",
        "0",
        "--set",
        "settings.mission=[[4.4, 3.4, 0.0]]",  # under the table
        "--set",
        "components.automove.parameters.recoveries=0",
    )

    assert answer.code == 1
    assert_words(answer.out, "runs/seed-0 failed", "mobile_supervisor", "mission failed")
    assert json.loads((tmp_path / "report.json").read_text())["failures"].keys() == {"runs/seed-0"}


@pytest.mark.accuracy
@pytest.mark.usefixtures("in_this_process")
def test_run_without_a_moved_object_is_not_counted(tmp_path: Path) -> None:
    late = "components.world.parameters.events=[{at: 900, move: object_8, to: {x: 4.7, y: 0}}]"
    answer = experiment("map-update", tmp_path, "--seeds", "0", "--set", late)

    assert answer.code == 1
    assert_words(answer.out, "runs/seed-0 failed", "900 s", "world")
    assert "repaired" not in answer.out


def test_folder_with_other_files_is_rejected_before_any_run(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")

    answer = experiment("map-update", tmp_path, "--seeds", "0")

    assert answer.code == 1
    assert f"{tmp_path}: this folder holds thesis.tex and no report of this command" in answer.err
    assert "name a new folder with --out" in answer.err
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("ablation", "--moved", "0"), "--moved 0 without --kidnap changes nothing"),
        (("ablation", "--moved", "40"), "only 10 of 10 objects can be moved"),
        (("ablation", "--scanner-range", "1.2", "--seeds", "x"), "write it as A..B"),
        (("uncertainty", "--set", "components.world.parameters.events=[]"), "nothing changes"),
        (("map-update", "--set", "components.localizr.x=1"), "localizr"),
        (("map-update", "--deployment", "none.yaml"), "none.yaml: there is no such deployment"),
        (("map-update", "--overlay", "none.yaml"), "none.yaml: there is no such deployment"),
    ],
)
def test_invalid_options_are_rejected_before_any_run(
    tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    command, *rest = options
    answer = experiment(command, tmp_path / "out", *rest)

    assert answer.code == 1
    assert message in answer.err
    assert not (tmp_path / "out" / "runs").exists()


def test_false_matches_require_the_geometric_driver(tmp_path: Path) -> None:
    answer = experiment("ablation", tmp_path, "--driver", "pixels", "--false-matches", "0.05")

    assert answer.code == 1
    assert "add --driver geometric" in answer.err
