"""Tests of `cairn map why`."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from cairn import SECOND, CairnError
from cairn.components.map_builder.cli import app
from cairn.components.map_builder.landmark_map import LandmarkKeeper
from cairn.visual_map.landmarks import EvidenceVerdict
from cairn.visual_map.new_map import write_map
from tests.components.map_builder.evidence import HERE, THERE, observation, surveyed
from tests.wording import assert_words, words_in_order


@pytest.fixture
def moved(tmp_path: Path) -> Path:
    """Return a map whose landmark 7 agreed from four poses, moved, and was registered."""
    path = tmp_path / "visual_map.cairn"
    write_map(path, "a test", [surveyed(6), surveyed(7)])
    keeper = LandmarkKeeper(path, None, 10**18)
    for step in range(12):
        at = 1_000_000_000 * SECOND + step * SECOND
        similarity = 0.1 if 4 <= step < 7 else 0.9
        position = HERE if step < 4 else THERE
        keeper.apply(
            at, [observation(similarity, step, position), observation(0.9, step, object_id=6)]
        )
        keeper.apply(at, [observation(similarity, step, position)])  # from the same pose once more
    keeper.save()
    keeper.close()
    return path


def why(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["why", *map(str, arguments)])
    if isinstance(result.exception, CairnError):
        raise result.exception
    return result


def test_history_goes_from_agreement_to_the_new_position(moved: Path) -> None:
    printed = why("7", "--map", moved).output

    first, *steps = printed.splitlines()
    assert "is at (3.50, 1.00) m" in first
    order = [
        next(k for k, step in enumerate(steps) if word in step)
        for word in ("IMPORTED", "agrees", "disagrees", "REMOVED", "REGISTERED")
    ]
    assert order == sorted(order)
    assert "reliability 0.90 -> 0.98" in printed
    assert "reliability 0.38 -> 0.06" in printed
    assert "1.50 m from its position" in printed
    assert_words(printed, "not counted", "same pose")


def test_object_is_found_by_name_and_only_its_evidence_is_printed(moved: Path) -> None:
    printed = why("landmark 6", "--map", moved).output

    assert "object 6 (landmark 6)" in printed
    assert "REMOVED" not in printed


def test_json_has_every_step(moved: Path) -> None:
    shown = json.loads(why("7", "--map", moved, "--json").output)

    evidence = [step for step in shown["steps"] if step["counted"] is not None]
    assert len(evidence) == 24
    assert shown["object"]["object_id"] == 7
    assert {step["verdict"] for step in evidence} == {"agrees", "disagrees"}
    assert evidence[0]["similarity"] == 0.9


def test_newest_steps_are_printed_and_others_counted(moved: Path) -> None:
    printed = why("7", "--map", moved, "--last", 3).output.splitlines()

    assert len(printed) == 5
    assert "--last N or --all" in printed[1]


def test_default_map_is_in_the_working_folder(moved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(moved.parent)

    assert "object 7" in why("7").output


def test_unknown_object_lists_the_known_ones(moved: Path) -> None:
    with pytest.raises(CairnError, match=words_in_order("99", "6 (landmark 6), 7")):
        why("99", "--map", moved)


def test_absences_are_part_of_the_history(tmp_path: Path) -> None:
    path = tmp_path / "a.cairn"
    write_map(path, "a test", [surveyed(7)])
    keeper = LandmarkKeeper(path, None, 10**18)
    for step in range(12):
        keeper.apply(step * SECOND, [observation(0.9, step % 3)])
    for step in range(3):
        keeper.apply(100 * SECOND, [observation(0.5, 3 * step, verdict=EvidenceVerdict.UNSEEN)])
    keeper.save()
    keeper.close()

    printed = why("7", "--map", path).output

    assert_words(printed, "not seen", "(2.00, 1.00)", "reliability 0.98 ->")


def test_summary_of_old_evidence_is_a_step_of_the_chain(
    moved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.visual_map.evidence_history.MOST_COUNTED", 3)
    keeper = LandmarkKeeper(moved, None, 10**18)
    keeper.apply(1_000_000_020 * SECOND, [observation(0.9, 20, THERE)])
    keeper.save()
    keeper.close()

    steps = why("7", "--map", moved).output.splitlines()[1:]

    order = [
        next(k for k, step in enumerate(steps) if all(word in step for word in words))
        for words in (("IMPORTED",), ("older pieces", "disagrees"), ("reliability 0.9", "agrees"))
    ]
    assert order == sorted(order)
    assert any("REMOVED" in step for step in steps)
