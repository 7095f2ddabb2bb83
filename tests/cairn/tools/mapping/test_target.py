"""Tests of the names of a map's files."""

from pathlib import Path

import pytest

from cairn.tools.mapping.target import map_files


@pytest.mark.parametrize("name", ["hall", "hall.yaml", "hall.graph"])
def test_map_is_named_by_its_name_or_by_one_of_its_files(tmp_path: Path, name: str) -> None:
    files = map_files(tmp_path / name, (".yaml", ".graph"), force=False)

    assert [file.name for file in files.values()] == ["hall.yaml", "hall.graph"]


def test_other_endings_belong_to_the_name(tmp_path: Path) -> None:
    files = map_files(tmp_path / "hall.2", (".yaml",), force=False)

    assert [file.name for file in files.values()] == ["hall.2.yaml"]
