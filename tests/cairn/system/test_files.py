"""A file that is replaced holds the old content or the new, whatever happens meanwhile."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cairn.system.files import replace_file, replacing
from tests.disk import room_for
from tests.wording import assert_words


def names(folder: Path) -> list[str]:
    return sorted(one.name for one in folder.iterdir())


def test_file_is_created_and_replaced_without_leftovers(tmp_path: Path) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"first")
    replace_file(file, b"second", durable=False)

    assert file.read_bytes() == b"second"
    assert names(tmp_path) == ["order.json"]


def test_full_disk_raises_and_leaves_the_file_unchanged(tmp_path: Path) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"old")
    with room_for(200), pytest.raises(OSError, match="File too large"):
        replace_file(file, b"new" * 100)

    assert file.read_bytes() == b"old"
    assert names(tmp_path) == ["order.json"]


def test_missing_folder_or_folder_in_place_of_the_file_raises(
    tmp_path: Path,
) -> None:
    with pytest.raises(FileNotFoundError):
        replace_file(tmp_path / "gone" / "order.json", b"new")

    (tmp_path / "order.json").mkdir()
    with pytest.raises(IsADirectoryError):
        replace_file(tmp_path / "order.json", b"new")
    assert names(tmp_path) == ["order.json"]


def test_content_is_synced_to_disk_before_the_file_is_renamed(
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


def test_leftover_of_a_killed_writer_is_replaced(tmp_path: Path) -> None:
    file = tmp_path / "order.json"
    replace_file(file, b"old")
    killed = """
import os, signal, sys
from pathlib import Path
from cairn.system.files import replacing
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


@pytest.mark.parametrize(
    ("limits", "allowed"), [((64, 5000), "1024"), ((300, 300), "300"), ((24, 24), "")], ids=str
)
def test_process_may_open_many_files_or_says_why_not(limits: tuple[int, int], allowed: str) -> None:
    program = f"""
import resource
from cairn.system.files import allow_many_files
resource.setrlimit(resource.RLIMIT_NOFILE, {limits})
allow_many_files()
print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
"""
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )

    assert run.stdout.strip() == allowed
    assert run.returncode == (not allowed)
    if not allowed:
        assert_words(run.stderr, "may open 24 files", "ulimit -n 1024")
