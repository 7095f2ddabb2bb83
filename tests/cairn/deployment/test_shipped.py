"""Shipped deployments, overlays and worlds are found by name."""

import re
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.components.simulation.world_component import WorldConfig
from cairn.deployment.load import load_deployment
from cairn.deployment.shipped import FOLDER, deployment_file, shipped, world_file
from tests.commands import cairn
from tests.wording import words_in_order

DEPLOYMENTS = [one for one in shipped() if not one.is_overlay]
OVERLAYS = [one for one in shipped() if one.is_overlay]


def test_file_in_the_current_folder_comes_before_a_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert deployment_file("sim") == FOLDER / "sim.yaml"
    Path("sim").write_text("cairn: 1\n")
    assert deployment_file("sim") == Path("sim")


def test_folder_in_the_current_folder_does_not_hide_a_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("office", "mine"):
        Path(name).mkdir()
    assert world_file("office") == FOLDER / "worlds" / "office.yaml"
    assert world_file("mine") == Path("mine")


@pytest.mark.parametrize("name", ["sim.yaml", "there/sim", "./sim"])
def test_path_is_not_looked_up_by_name(name: str) -> None:
    assert deployment_file(name) == Path(name)


def test_unknown_name_is_reported_with_the_known_ones() -> None:
    with pytest.raises(CairnError, match=words_in_order("smi", "sim, ", "pixels")):
        deployment_file("smi")
    with pytest.raises(CairnError, match=words_in_order("hell", "hall, museum")):
        world_file("hell")


@pytest.mark.parametrize("deployment", DEPLOYMENTS, ids=lambda one: one.name)
def test_shipped_deployments_have_no_problem(deployment: tuple[str, bool, str, Path]) -> None:
    load_deployment(deployment[3])


@pytest.mark.parametrize("overlay", OVERLAYS, ids=lambda one: one.name)
def test_shipped_overlays_name_a_deployment_that_they_fit(
    overlay: tuple[str, bool, str, Path],
) -> None:
    name, _, _, file = overlay
    quoted = re.search(
        rf"cairn up (\w+)((?: --overlay \w+)*) --overlay {name}\b", file.read_text(encoding="utf-8")
    )

    assert quoted is not None
    others = re.findall(r"--overlay (\w+)", quoted[2])
    load_deployment(deployment_file(quoted[1]), [*map(deployment_file, others), file])


def test_deployments_are_listed_with_their_purpose() -> None:
    rows = {row["name"]: row for row in cairn("deployments", "--json").json}

    assert (rows["sim"]["kind"], rows["pixels"]["kind"]) == ("deployment", "overlay")
    assert rows["sim"]["summary"] == "A simulated robot in a simulated world, ready for goals"
    assert all(row["summary"] for row in rows.values())
    assert "sim " in cairn("deployments").out


def test_simulated_world_of_a_deployment_is_named_like_a_file_or_a_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("office").mkdir()  # the report of an earlier run

    assert WorldConfig.model_validate({"world": "office"}).world == (
        FOLDER / "worlds" / "office.yaml"
    )
    assert WorldConfig.model_validate({"world": "my/room.yaml"}).world == Path("my/room.yaml")
    with pytest.raises(ValueError, match=words_in_order("offic", "did you mean office")):
        WorldConfig.model_validate({"world": "offic"})


def test_commands_take_shipped_names() -> None:
    assert cairn("check", "sim", "--overlay", "pixels", "--json").json["valid"]
    assert cairn("check", "mapping", "--set", "world=office", "--json").json["valid"]
    assert "12 objects" in cairn("world", "check", "hall").out
