"""Old run folders lose their logs, never their maps; a folder in use is left alone."""

from pathlib import Path

import pytest

from cairn.cli.run_folders import reduce_old, used_folder
from cairn.errors import CairnError
from cairn.runtime.child_spec import Storage
from tests.wording import assert_words


def make_run(runs: Path, number: int, size: int = 1000) -> Path:
    folder = runs / f"2026{number:04}-sim"
    (folder / "logs").mkdir(parents=True)
    (folder / "logs" / "base.log").write_bytes(bytes(size))
    (folder / "record.jsonl").write_bytes(bytes(10))
    for name in ("visual_map.cairn", "visual_map.cairn-wal", "map.yaml", "map.pgm", "mission.json"):
        (folder / name).write_bytes(bytes(10))
    return folder


def complete(folders: list[Path]) -> list[bool]:
    return [(folder / "logs").exists() for folder in folders]


def test_old_runs_keep_maps_and_missions_and_lose_logs(tmp_path: Path) -> None:
    folders = [make_run(tmp_path, number) for number in range(5)]
    empty = make_run(tmp_path, 9999)
    for path in empty.glob("*.*"):
        path.unlink()
    empty = empty.rename(tmp_path / "2025-failed")

    (text,) = reduce_old(tmp_path, Storage(kept_runs=3), folders[4])

    assert complete(folders) == [False, False, True, True, True]
    assert sorted(path.name for path in folders[0].iterdir()) == [
        "map.pgm", "map.yaml", "mission.json", "visual_map.cairn", "visual_map.cairn-wal",
    ]  # fmt: skip
    assert not empty.exists()
    assert_words(text, "removed the logs", "3 old runs", "2025-failed to 20260001-sim", "maps")
    assert reduce_old(tmp_path, Storage(kept_runs=3), folders[4]) == []


def test_large_runs_are_reduced_earlier_and_too_large_maps_reported(tmp_path: Path) -> None:
    folders = [make_run(tmp_path, number, size=600_000) for number in range(4)]

    (text,) = reduce_old(tmp_path, Storage(max_runs_size=1_300_000), folders[3])
    assert complete(folders) == [False, False, True, True]
    assert "2 old runs" in text

    (folders[0] / "map.pgm").write_bytes(bytes(3_000_000))
    _, text = reduce_old(tmp_path, Storage(max_runs_size=1_300_000), folders[3])
    assert_words(text, str(tmp_path), "3.6", "MB", "storage.max_runs_size", "remove")
    assert (folders[0] / "map.pgm").exists()


def test_run_that_is_under_way_is_left_alone(tmp_path: Path) -> None:
    folders = [make_run(tmp_path, number) for number in range(3)]
    with used_folder(folders[0]) as logs:
        (logs / "root.log").touch()
        reduce_old(tmp_path, Storage(kept_runs=1), folders[2])

        assert complete(folders) == [True, False, True]
        with pytest.raises(CairnError, match="used by another run"), used_folder(folders[0]):
            pass
    with used_folder(folders[0]):
        pass


def test_logs_of_an_earlier_run_in_the_folder_are_removed(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    for name in ("base.log", "base.log.1", "notes.txt"):
        (tmp_path / "logs" / name).touch()
    with used_folder(tmp_path) as logs:
        assert [path.name for path in logs.iterdir()] == ["notes.txt"]
