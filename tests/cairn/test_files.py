"""A file that is replaced holds the old content or the new, whatever happens meanwhile."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cairn.files import replace_file, replacing
from tests.disk import room_for


def names(folder: Path) -> list[str]:
    return sorted(one.name for one in folder.iterdir())


def test_a_file_is_made_and_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"first")
    replace_file(file, b"second", durable=False)

    assert file.read_bytes() == b"second"
    assert names(tmp_path) == ["order.json"]


def test_a_full_disk_is_the_callers_matter_and_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"old")
    with room_for(200), pytest.raises(OSError, match="File too large"):
        replace_file(file, b"new" * 100)

    assert file.read_bytes() == b"old"
    assert names(tmp_path) == ["order.json"]


def test_a_lost_folder_and_a_folder_in_the_files_place_are_the_callers_matter(
    tmp_path: Path,
) -> None:
    with pytest.raises(FileNotFoundError):
        replace_file(tmp_path / "gone" / "order.json", b"new")

    (tmp_path / "order.json").mkdir()
    with pytest.raises(IsADirectoryError):
        replace_file(tmp_path / "order.json", b"new")
    assert names(tmp_path) == ["order.json"]


def test_content_is_on_the_disk_before_it_gets_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"old")
    when_synced: list[tuple[bytes, bytes]] = []

    def note(descriptor: int) -> None:
        synced = Path(f"/proc/self/fd/{descriptor}").read_bytes()
        when_synced.append((synced, file.read_bytes()))

    monkeypatch.setattr(os, "fsync", note)
    replace_file(file, b"new")
    replace_file(file, b"hasty", durable=False)

    assert when_synced == [(b"new", b"old")]


def test_what_a_killed_writer_left_is_no_hindrance(tmp_path: Path) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"old")
    killed = """
import os, signal, sys
from pathlib import Path
from cairn.files import replacing
with replacing(Path(sys.argv[1])) as part:
    part.write_bytes(b"half of the n")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    run = subprocess.run([sys.executable, "-c", killed, file], check=False)
    assert run.returncode == -signal.SIGKILL
    assert file.read_bytes() == b"old"

    with replacing(file) as part:
        assert not part.exists()
        part.write_bytes(b"new")

    assert file.read_bytes() == b"new"
    assert names(tmp_path) == ["order.json"]
