"""`cairn map why` tells the chain of evidence that made an object what it is in the map."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from cairn import SECOND, CairnError
from cairn.components.map_builder.cli import app
from cairn.components.map_builder.importing import write_map
from cairn.components.map_builder.keeper import MapKeeper
from cairn.components.map_builder.objects import Verdict
from tests.components.map_builder.evidence import HERE, THERE, sighting, surveyed


@pytest.fixture
def moved(tmp_path: Path) -> Path:
    """A map whose object 7 agreed from four places, was then seen elsewhere, and registered."""
    path = tmp_path / "visual_map.cairn"
    write_map(path, "a test", [surveyed(6), surveyed(7)])
    keeper = MapKeeper(path, None, 10**18, learn_unknown=True)
    for step in range(12):
        at = 1_000_000_000 * SECOND + step * SECOND
        similarity = 0.1 if 4 <= step < 7 else 0.9
        place = HERE if step < 4 else THERE
        keeper.apply(at, [sighting(similarity, step, place), sighting(0.9, step, object_id=6)])
        keeper.apply(at, [sighting(similarity, step, place)])  # from the same pose once more
    keeper.close()
    return path


def why(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["why", *map(str, arguments)])
    if isinstance(result.exception, CairnError):
        raise result.exception
    return result


def test_the_chain_goes_from_agreement_to_the_new_place(moved: Path) -> None:
    told = why("7", "--map", moved).output

    first, *steps = told.splitlines()
    assert "stands at (3.50, 1.00) m" in first
    order = [
        next(k for k, step in enumerate(steps) if word in step)
        for word in ("IMPORTED", "agrees", "disagrees", "REMOVED", "REGISTERED")
    ]
    assert order == sorted(order)
    assert "reliability 0.90 -> 0.98" in told
    assert "reliability 0.38 -> 0.06" in told
    assert "1.50 m from its place" in told
    assert "not counted: seen from the same pose as before" in told


def test_an_object_is_found_by_its_name_and_only_its_own_evidence_is_told(moved: Path) -> None:
    told = why("landmark 6", "--map", moved).output

    assert "object 6 (landmark 6)" in told
    assert "REMOVED" not in told


def test_json_has_every_step(moved: Path) -> None:
    shown = json.loads(why("7", "--map", moved, "--json").output)

    evidence = [step for step in shown["steps"] if step["counted"] is not None]
    assert len(evidence) == 24
    assert shown["object"]["object_id"] == 7
    assert {step["verdict"] for step in evidence} == {"agrees", "disagrees"}
    assert evidence[0]["similarity"] == 0.9


def test_the_newest_steps_are_shown_and_the_others_counted(moved: Path) -> None:
    told = why("7", "--map", moved, "--last", 3).output.splitlines()

    assert len(told) == 5
    assert "--all has more" in told[1]


def test_the_map_is_that_of_the_folder_if_none_is_named(
    moved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(moved.parent)

    assert "object 7" in why("7").output


def test_an_object_that_is_not_there_is_told_with_those_that_are(moved: Path) -> None:
    with pytest.raises(CairnError, match=r"no object 99; there are 6 \(landmark 6\), 7"):
        why("99", "--map", moved)


def test_what_was_not_seen_is_part_of_the_chain(tmp_path: Path) -> None:
    path = tmp_path / "a.cairn"
    write_map(path, "a test", [surveyed(7)])
    keeper = MapKeeper(path, None, 10**18, learn_unknown=True)
    for step in range(12):
        keeper.apply(step * SECOND, [sighting(0.9, step % 3)])
    for step in range(3):
        keeper.apply(100 * SECOND, [sighting(0.5, 3 * step, verdict=Verdict.UNSEEN)])
    keeper.close()

    told = why("7", "--map", path).output

    assert "not seen at (2.00, 1.00), where it should be in view; reliability 0.98 ->" in told
