"""`cairn map` imports and shows maps, and refuses what it cannot do in words."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from cairn.errors import CairnError
from components.map_builder.cli import app


def cairn_map(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if isinstance(result.exception, CairnError):
        raise result.exception
    return result


def objects(path: Path) -> dict[int, dict[str, object]]:
    shown = json.loads(cairn_map("show", path, "--json").output)
    return {o["object_id"]: o for o in shown["objects"]}


def test_a_data_set_becomes_a_map(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "sub" / "hall.map"

    result = cairn_map("import", "mrclam", dataset, out)

    assert result.exit_code == 0
    known = objects(out)
    assert set(known) == set(range(6, 21))
    assert known[6]["x"] == pytest.approx(0.58831396)
    assert {o["reliability"] for o in known.values()} == {0.5}


def test_objects_can_be_displaced_and_left_out(dataset: Path, tmp_path: Path) -> None:
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


def test_a_map_is_replaced_only_by_force(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "hall.map"
    cairn_map("import", "mrclam", dataset, out)

    with pytest.raises(CairnError, match=r"exists already.*--force"):
        cairn_map("import", "mrclam", dataset, out, "--remove", 6)
    cairn_map("import", "mrclam", dataset, out, "--remove", 6, "--force")

    assert 6 not in objects(out)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--displace", "8"], "--displace 8: write it as ID:DX,DY"),
        (["--displace", "8:a,b"], "write it as ID:DX,DY"),
        (["--displace", "8:nan,0"], "must be finite"),
        (["--displace", "8:1,0", "--displace", "8:0,1"], "names object 8 twice"),
        (["--displace", "99:1,0"], "the map holds no object 99; it holds 6, 7"),
        (["--remove", "99"], "the map holds no object 99"),
        (["--displace", "8:1,0", "--remove", "8"], "cannot be both"),
    ],
)
def test_a_wrong_order_is_explained(
    dataset: Path, tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    with pytest.raises(CairnError) as refused:
        cairn_map("import", "mrclam", dataset, tmp_path / "hall.map", *arguments)

    assert complaint in str(refused.value)
    assert not (tmp_path / "hall.map").exists()


def test_an_importer_that_does_not_exist_is_told_with_those_that_do(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"no importer 'mclam'.*known: .*mrclam"):
        cairn_map("import", "mclam", tmp_path, tmp_path / "hall.map")


def test_the_table_and_its_history_name_objects_and_reasons(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "hall.map"
    cairn_map("import", "mrclam", dataset, out)

    table = cairn_map("show", out, "--history").output

    assert "13  landmark 13   3.12  -2.29         0.50  live          0" in table
    assert "imported  " in table
    assert "imported by mrclam from " in table
