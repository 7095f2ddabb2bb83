"""A report never mixes with earlier files in its folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cairn import CairnError
from cairn_lab.experiments.report_folder import ReportFolder, open_report, write_report
from tests.wording import words_in_order


def folder_of(path: Path, experiment: str = "ablation") -> ReportFolder:
    return ReportFolder(path, experiment, ("ablation.png",))


def write(folder: ReportFolder, *seeds: int) -> None:
    """A report with runs and a picture."""
    with open_report(folder):
        for seed in seeds:
            folder.run(seed).mkdir(parents=True)
            (folder.run(seed) / "world.jsonl").write_text("")
        pictures = {"ablation.png": lambda file: file.write_bytes(b"picture")}
        write_report(folder, ["lines"], {"seeds": list(seeds)}, (), pictures)


def files_of(path: Path) -> list[str]:
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def test_earlier_report_of_the_same_experiment_is_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path / "out")
    write(folder, 0, 1, 2)
    (folder.path / "notes.md").write_text("mine")

    with open_report(folder):
        assert files_of(folder.path) == ["notes.md", "report.json"]
        assert json.loads((folder.path / "report.json").read_text())["finished"] is False
        assert "the earlier report is replaced" in capsys.readouterr().err
        write_report(folder, ["lines"], {"seeds": [7]}, (), {})
    report = json.loads((folder.path / "report.json").read_text())
    assert (report["experiment"], report["finished"], report["seeds"]) == ("ablation", True, [7])


def test_interrupted_report_is_replaced(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "out")
    with open_report(folder):
        folder.run(0).mkdir(parents=True)

    with open_report(folder):
        assert files_of(folder.path) == ["report.json"]
        assert not folder.run(0).exists()


def test_second_experiment_does_not_write_into_the_same_folder(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    with open_report(folder):
        folder.run(0).mkdir(parents=True)

        with pytest.raises(CairnError, match="another experiment is writing its report") as error:
            open_report(folder).__enter__()

        assert folder.run(0).exists()
    assert "--out" in str(error.value)


def test_report_of_another_experiment_is_not_overwritten(tmp_path: Path) -> None:
    write(folder_of(tmp_path), 0)
    before = files_of(tmp_path)

    with pytest.raises(CairnError, match=words_in_order("report", "ablation")) as error:
        open_report(folder_of(tmp_path, "map-update")).__enter__()

    assert str(tmp_path) in str(error.value)
    assert "--out" in str(error.value)
    assert files_of(tmp_path) == before


@pytest.mark.parametrize("report", ["", "[1]", '{"experiment": 3}', '{"summary": []}'])
def test_folder_with_other_files_is_not_overwritten(tmp_path: Path, report: str) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "mine.txt").write_text("mine")
    (tmp_path / "report.json").write_text(report)

    with pytest.raises(CairnError, match=words_in_order("report.json, runs", "no report")):
        open_report(folder_of(tmp_path)).__enter__()

    assert files_of(tmp_path) == ["report.json", "runs/mine.txt"]


def test_file_in_place_of_the_folder_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "out"
    file.write_text("")

    with pytest.raises(CairnError, match=words_in_order("out", "File exists", "name another")):
        open_report(folder_of(file)).__enter__()
