"""`cairn experiment`, as a user runs it."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import pytest

from cairn.tools.experiments import ablation, runs
from cairn.tools.experiments.room import Room
from cairn.tools.experiments.series import read_pair, read_world
from tests.commands import Answer, cairn

pytestmark = pytest.mark.processes


DEPLOY = Path(__file__).parents[4] / "deploy"
# To where objects 8 and 9 hang, and back.
TOUR = "settings.mission=[[4.6, 1.6, -1.0], [4.4, 1.5, -0.6]]"


@pytest.fixture(autouse=True, scope="module")
def room_once() -> Iterator[None]:
    """Where in the room objects could hang takes seconds to find, and is the same each time."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ablation, "Room", cache(Room))
        yield


@pytest.fixture
def on_a_thread(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Runs one by one on a thread, which begins at once: its processes are for the ablation."""
    monkeypatch.setattr(runs, "worker_pool", lambda _: ThreadPoolExecutor(1))
    told = logging.getLogger("cairn").propagate
    yield
    logging.getLogger("cairn").propagate = told


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
        *options,
    )


def test_an_ablation_compares_all_methods_on_the_same_data(tmp_path: Path) -> None:
    way = "settings.mission=[[4.6, 1.6, -1.0]]"
    answer = experiment(
        "ablation", tmp_path, "--seeds", "0", "--at", "6", "--moved", "2", "--set", way
    )

    assert answer.code == 0, answer
    assert "1 of 1: runs/seed-0 done" in answer.err
    for title in ("ours (likelihood ratio)", "paper, clamped", "persistence filter", "no update"):
        assert title in answer.out
    assert "1 run cannot tell which method is better" in answer.out
    assert "of means none: there is 1 run only" in answer.out
    report = json.loads((tmp_path / "report.json").read_text())
    assert (tmp_path / "report.txt").read_text().splitlines()[0] in answer.out
    assert [one["method"] for one in report["summary"]] == [
        "ours",
        "letter",
        "paper",
        "chi_square",
        "persistence",
        "no_update",
    ]
    (run,) = report["runs"]
    assert [move["moved_at"] for move in run["pairs"][0]["moves"]] == [6.0, 6.0]
    assert report["about"]["MethodSummary"]["recall"].startswith("Moved objects that were removed,")
    assert (tmp_path / "ablation.png").read_bytes().startswith(b"\x89PNG")
    folder = tmp_path / "runs" / "seed-0"
    assert len(read_world(folder / "world.jsonl").moves) == 2
    last = [read_pair(folder / f"{one['method']}.jsonl").stamps[-1] for one in report["summary"]]
    assert max(last) - min(last) < 0.2


@pytest.mark.usefixtures("on_a_thread")
def test_without_a_change_the_environment_is_the_same_to_the_last_bit(tmp_path: Path) -> None:
    """Both runs of a seed drive the same way: what differs comes of the change alone."""
    event = "components.world.parameters.events=[{at: 8, move: object_9, to: {x: 9, y: 1.9}}]"
    answer = experiment("uncertainty", tmp_path, "--seeds", "1", "--set", event, "--json")

    assert answer.code == 0, answer
    report = (tmp_path / "report.txt").read_text()
    assert report.count("In none of 1 way the moved object was registered anew") == 2  # filters
    figures = {
        (one["condition"], one["phase"], one["quantity"]): one["against_unchanged"]["mean"]
        for one in answer.json["summary"]
    }
    for condition in ("updated", "not_updated"):
        for quantity in ("position_spread", "position_sd", "position_error"):
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


@pytest.mark.usefixtures("on_a_thread")
def test_a_map_update_shows_its_maps(tmp_path: Path) -> None:
    place = "{x: 4.7, y: 0, theta: 1.5708}"
    event = f"components.world.parameters.events=[{{at: 6, move: object_8, to: {place}}}]"
    answer = experiment("map-update", tmp_path, "--seeds", "0", "--set", event)

    assert answer.code == 0, answer
    assert "ours (likelihood ratio), run by run:" in answer.out
    for picture in ("maps_a_h.png", "reliability.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("on_a_thread")
def test_runs_that_fail_are_told_and_end_with_status_1(tmp_path: Path) -> None:
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
    assert "runs/seed-0 failed: mobile_supervisor has finished: the mission failed" in answer.out
    assert json.loads((tmp_path / "report.json").read_text())["failures"].keys() == {"runs/seed-0"}


@pytest.mark.usefixtures("on_a_thread")
def test_a_run_in_which_nothing_was_moved_counts_for_nothing(tmp_path: Path) -> None:
    late = "components.world.parameters.events=[{at: 900, move: object_8, to: {x: 4.7, y: 0}}]"
    answer = experiment("map-update", tmp_path, "--seeds", "0", "--set", late)

    assert answer.code == 1
    assert "runs/seed-0 failed: nothing was moved at 900 s: the world refused it" in answer.out
    assert "repaired" not in answer.out


def test_a_folder_that_holds_anything_else_is_refused_before_any_run(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")

    answer = experiment("map-update", tmp_path, "--seeds", "0")

    assert answer.code == 1
    assert f"{tmp_path} holds thesis.tex and no report of this command" in answer.err
    assert "name a new folder with --out" in answer.err
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("ablation", "--moved", "0"), "--moved 0 without --kidnap leaves nothing"),
        (("ablation", "--moved", "40"), "of 10 objects only 10 can be moved"),
        (("ablation", "--scanner-range", "1.2", "--seeds", "x"), "write it as A..B"),
        (("uncertainty", "--set", "components.world.parameters.events=[]"), "nothing is changed"),
        (("map-update", "--set", "components.localizr.x=1"), "localizr"),
        (("map-update", "--deployment", "none.yaml"), "none.yaml: no such deployment"),
        (("map-update", "--overlay", "none.yaml"), "none.yaml: no such deployment"),
    ],
)
def test_what_cannot_be_is_told_before_any_run(
    tmp_path: Path, options: tuple[str, ...], told: str
) -> None:
    command, *rest = options
    answer = experiment(command, tmp_path / "out", *rest)

    assert answer.code == 1
    assert told in answer.err
    assert not (tmp_path / "out" / "runs").exists()


def test_false_matches_are_for_the_geometric_driver(tmp_path: Path) -> None:
    answer = experiment("ablation", tmp_path, "--driver", "pixels", "--false-matches", "0.05")

    assert answer.code == 1
    assert "add --driver geometric" in answer.err
