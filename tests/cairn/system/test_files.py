"""A file that is replaced holds the old content or the new, whatever happens meanwhile."""

import errno
import os
import signal
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from cairn.errors import CairnError
from cairn.system.files import (
    complete_replacement,
    explain_os_error,
    replace_file,
    replacing,
    replacing_together,
)
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


OLD = {"hall.yaml": "old", "hall.pgm": "old", "hall.graph": "old"}
NEW = {"hall.yaml": "new", "hall.pgm": "new", "hall.tum": "new"}


def contents(folder: Path) -> dict[str, str]:
    return {one.name: one.read_text() for one in folder.iterdir() if not one.name.startswith(".")}


def replace_hall(folder: Path) -> None:
    files = {name: folder / name for name in OLD | NEW}
    with replacing_together(files) as parts:
        for name, content in NEW.items():
            parts[name].write_text(content)


def killed_at(step: int, folder: Path) -> bool:
    """Replace the files in a process that is killed before so many operations on the folder."""
    child = os.fork()
    if child == 0:
        steps = count()
        for name in ("mkdir", "rename", "replace", "unlink", "rmdir"):
            real = getattr(os, name)

            def step_or_end(*arguments: Any, real: Any = real, **options: Any) -> Any:
                if next(steps) == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                return real(*arguments, **options)

            setattr(os, name, step_or_end)
        replace_hall(folder)
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def test_files_that_are_replaced_together_are_of_one_time_whenever_the_process_is_killed(
    tmp_path: Path,
) -> None:
    found = []
    for step in count():
        folder = tmp_path / str(step)
        folder.mkdir()
        for name, content in OLD.items():
            (folder / name).write_text(content)
        if not killed_at(step, folder):
            break
        complete_replacement(folder / "hall.graph")
        found.append(contents(folder))
        replace_hall(folder)
        assert names(folder) == sorted(NEW)

    assert all(one in (OLD, NEW) for one in found)
    assert found[0] == OLD
    assert found[-1] == NEW
    assert len(found) > 6


def test_files_that_cannot_be_written_together_stay_and_are_named(tmp_path: Path) -> None:
    replace_file(tmp_path / "hall.yaml", b"old")
    files = {name: tmp_path / name for name in NEW}

    def write() -> None:
        with replacing_together(files) as parts:
            raise CairnError(f"{parts['hall.pgm']}: takes no data")

    with pytest.raises(CairnError) as refused:
        write()
    assert str(refused.value) == f"{tmp_path / 'hall.pgm'}: takes no data"
    assert names(tmp_path) == ["hall.yaml"]


def test_replacement_removes_no_other_files(tmp_path: Path) -> None:
    folder = tmp_path / "maps"
    written = folder / ".hall.new"
    written.mkdir(parents=True)
    other, outside = folder / "room.yaml", tmp_path / "hall.yaml"
    for file in (other, outside):
        file.write_text("stays")
    (written / ".removed").write_bytes(b"../hall.yaml\nroom.yaml\n\xff\n/hall.yaml\n..\nhall.tum")
    (folder / "hall.tum").write_text("old")

    complete_replacement(folder / "hall.graph")

    assert (other.read_text(), outside.read_text()) == ("stays", "stays")
    assert names(folder) == ["room.yaml"]


def test_remedy_names_the_disk_that_is_full() -> None:
    full = OSError(errno.ENOSPC, "No space left on device")

    assert "on the disk at /proc" in explain_os_error(full, Path("/proc/self/map.cairn"))
    assert "on its disk" in explain_os_error(full)
    # What the error names is on it, whatever was to be written; `path` is only the next best.
    named = OSError(errno.ENOSPC, "No space left on device", "/proc/self/log")
    assert "on the disk at /proc" in explain_os_error(named, Path("/map.cairn"))
