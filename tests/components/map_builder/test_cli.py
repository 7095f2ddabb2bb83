"""Tests of `cairn map import` and `cairn map show`."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from cairn import CairnError
from cairn.components.map_builder.cli import app
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid
from cairn.planar.map_file import read_map, write_map
from tests.wording import words_in_order

ROOM = Path(__file__).parents[3] / "deploy" / "worlds" / "room.yaml"


def cairn_map(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if isinstance(result.exception, CairnError):
        raise result.exception
    return result


def objects(path: Path) -> dict[int, dict[str, object]]:
    shown = json.loads(cairn_map("show", path, "--json").output)
    return {o["object_id"]: o for o in shown["objects"]}


def test_data_set_is_imported(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "sub" / "hall.map"

    result = cairn_map("import", "mrclam", dataset, out)

    assert result.exit_code == 0
    known = objects(out)
    assert set(known) == set(range(6, 21))
    assert known[6]["x"] == pytest.approx(0.58831396)
    assert {o["reliability"] for o in known.values()} == {0.5}


def test_objects_can_be_displaced_and_removed(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "hall.map"

    cairn_map(
        "import", "mrclam", dataset, out, "--displace", "8:1.5,-0.5", "--displace", "11:0,1",
        "--remove", 20,
    )  # fmt: skip

    known = objects(out)
    assert 20 not in known
    assert known[8]["x"] == pytest.approx(0.85910813 + 1.5)
    assert known[8]["y"] == pytest.approx(-4.46878303 - 0.5)
    assert known[11]["y"] == pytest.approx(-2.53798053 + 1.0)


def test_existing_map_is_replaced_only_with_force(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "hall.map"
    cairn_map("import", "mrclam", dataset, out)

    with pytest.raises(CairnError, match=r"exists already.*--force"):
        cairn_map("import", "mrclam", dataset, out, "--remove", 6)
    cairn_map("import", "mrclam", dataset, out, "--remove", 6, "--force")

    assert 6 not in objects(out)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--displace", "8"], "--displace 8: write it as ID:DX,DY"),
        (["--displace", "8:a,b"], "write it as ID:DX,DY"),
        (["--displace", "8:nan,0"], "must be finite"),
        (["--displace", "8:1,0", "--displace", "8:0,1"], "names object 8 twice"),
        (["--displace", "99:1,0"], "the map has no object 99; it has 6, 7"),
        (["--remove", "99"], "the map has no object 99"),
        (["--displace", "8:1,0", "--remove", "8"], "cannot be both"),
    ],
)
def test_invalid_arguments_are_rejected_with_reason(
    dataset: Path, tmp_path: Path, arguments: list[str], message: str
) -> None:
    with pytest.raises(CairnError) as raised:
        cairn_map("import", "mrclam", dataset, tmp_path / "hall.map", *arguments)

    assert message in str(raised.value)
    assert not (tmp_path / "hall.map").exists()


def test_unknown_importer_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"no importer .*'mclam'; available: .*mrclam"):
        cairn_map("import", "mclam", tmp_path, tmp_path / "hall.map")


def test_importer_of_the_other_kind_of_map_is_rejected(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=words_in_order("carmen", "grid map", ".yaml")):
        cairn_map("import", "carmen", tmp_path / "run.log", tmp_path / "map.png")
    with pytest.raises(CairnError, match=words_in_order("mrclam", "visual map", "map.cairn")):
        cairn_map("import", "mrclam", dataset, tmp_path / "map.yaml")


def test_world_is_imported_with_the_requested_cell_size(tmp_path: Path) -> None:
    out = tmp_path / "room.yaml"

    printed = cairn_map("import", "world", ROOM, out, "--resolution", "0.1").output

    assert "cells of 0.1 m" in printed
    assert read_map(out).frame.resolution == 0.1


def test_files_of_another_map_are_replaced_only_by_force_and_all_of_them(tmp_path: Path) -> None:
    graph = tmp_path / "room.graph"
    graph.write_text("of the map before")

    with pytest.raises(CairnError, match=r"room\.graph exists already"):
        cairn_map("import", "world", ROOM, tmp_path / "room", "--resolution", "0.1")
    assert graph.read_text() == "of the map before"
    cairn_map("import", "world", ROOM, tmp_path / "room", "--resolution", "0.1", "--force")

    written = sorted(file.name for file in tmp_path.iterdir())
    assert written == ["room.cairn", "room.pgm", "room.yaml"]


def test_name_without_an_ending_gets_all_maps_that_the_importer_makes(
    dataset: Path, tmp_path: Path
) -> None:
    cairn_map("import", "world", ROOM, tmp_path / "room", "--resolution", "0.1")
    cairn_map("import", "mrclam", dataset, tmp_path / "hall")

    assert {file.name for file in tmp_path.iterdir()} >= {"room.yaml", "room.pgm", "room.cairn"}
    assert read_map(tmp_path / "room.yaml").frame.resolution == 0.1
    assert set(objects(tmp_path / "hall.cairn")) == set(range(6, 21))
    assert not (tmp_path / "hall.yaml").exists()
    (tmp_path / "room.yaml").unlink()
    with pytest.raises(CairnError, match=r"room\.cairn exists already"):
        cairn_map("import", "world", ROOM, tmp_path / "room")
    assert not (tmp_path / "room.yaml").exists()
    with pytest.raises(CairnError, match=r"no importer .*'wold'; available: .*carmen.*mrclam"):
        cairn_map("import", "wold", ROOM, tmp_path / "room")


def test_grid_map_is_shown_with_size_origin_and_cells(tmp_path: Path) -> None:
    file = tmp_path / "map.yaml"
    cells = np.array([[FREE] * 4, [FREE, OCCUPIED, UNKNOWN, UNKNOWN]], np.int8)
    write_map(file, Grid(cells, Frame(0.5, (-1.0, 2.0, 0.1))))

    shown = json.loads(cairn_map("show", file, "--json").output)
    assert shown == {
        "resolution": 0.5, "width_m": 2.0, "height_m": 1.0, "columns": 4, "rows": 2,
        "origin": {"x": -1.0, "y": 2.0, "theta": 0.1},
        "free": 0.625, "occupied": 0.125, "unknown": 0.25,
    }  # fmt: skip
    assert cairn_map("show", file).output == (
        "map.yaml: 2.00 m x 1.00 m, cells of 0.5 m\n"
        "its origin is at (-1.00, 2.00) m, rotated by 0.100 rad\n"
        "free 62.5 %, occupied 12.5 %, unknown 25.0 %\n"
    )
    with pytest.raises(CairnError, match="no history"):
        cairn_map("show", file, "--history")


def test_show_prints_objects_and_history_with_reasons(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "hall.map"
    cairn_map("import", "mrclam", dataset, out)

    table = cairn_map("show", out, "--history").output

    assert "13  landmark 13   3.12  -2.29         0.50  live          0" in table
    assert "imported  " in table
    assert "imported by mrclam from " in table
