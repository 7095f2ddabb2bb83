"""A report never mixes with what its folder held before."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.tools.experiments.report_folder import ReportFolder, begun, write_report


def folder_of(path: Path, experiment: str = "ablation") -> ReportFolder:
    return ReportFolder(path, experiment, ("ablation.png",))


def write(folder: ReportFolder, *seeds: int) -> None:
    """A report with runs and a picture."""
    with begun(folder):
        for seed in seeds:
            folder.run(seed).mkdir(parents=True)
            (folder.run(seed) / "world.jsonl").write_text("")
        pictures = {"ablation.png": lambda file: file.write_bytes(b"picture")}
        write_report(folder, ["lines"], {"seeds": list(seeds)}, (), pictures)


def files_of(path: Path) -> list[str]:
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def test_an_earlier_report_of_the_same_experiment_is_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path / "out")
    write(folder, 0, 1, 2)
    (folder.path / "notes.md").write_text("mine")

    with begun(folder):
        assert files_of(folder.path) == ["notes.md", "report.json"]
        assert json.loads((folder.path / "report.json").read_text())["finished"] is False
        assert "the earlier report is replaced" in capsys.readouterr().err
        write_report(folder, ["lines"], {"seeds": [7]}, (), {})
    report = json.loads((folder.path / "report.json").read_text())
    assert (report["experiment"], report["finished"], report["seeds"]) == ("ablation", True, [7])


def test_one_that_was_interrupted_is_replaced(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "out")
    with begun(folder):
        folder.run(0).mkdir(parents=True)

    with begun(folder):
        assert files_of(folder.path) == ["report.json"]
        assert not folder.run(0).exists()


def test_two_at_a_time_do_not_write_into_one_folder(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    with begun(folder):
        folder.run(0).mkdir(parents=True)

        with pytest.raises(CairnError, match="another experiment writes its report into") as it:
            begun(folder).__enter__()

        assert folder.run(0).exists()
    assert "--out" in str(it.value)


def test_the_report_of_another_experiment_is_left_alone(tmp_path: Path) -> None:
    write(folder_of(tmp_path), 0)
    before = files_of(tmp_path)

    with pytest.raises(
        CairnError, match="holds a report of cairn experiment ablation, which"
    ) as it:
        begun(folder_of(tmp_path, "map-update")).__enter__()

    assert str(tmp_path) in str(it.value)
    assert "--out" in str(it.value)
    assert files_of(tmp_path) == before


@pytest.mark.parametrize("report", ["", "[1]", '{"experiment": 3}', '{"summary": []}'])
def test_a_folder_with_anything_else_is_left_alone(tmp_path: Path, report: str) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "mine.txt").write_text("mine")
    (tmp_path / "report.json").write_text(report)

    with pytest.raises(CairnError, match=r"holds report\.json, runs and no report of this command"):
        begun(folder_of(tmp_path)).__enter__()

    assert files_of(tmp_path) == ["report.json", "runs/mine.txt"]


def test_what_is_no_folder_is_told_of(tmp_path: Path) -> None:
    file = tmp_path / "out"
    file.write_text("")

    with pytest.raises(CairnError, match=r"out cannot be written: .*File exists; name another"):
        begun(folder_of(file)).__enter__()
