"""The runtime folder is found by one rule, and a folder that others could use is refused."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.system import runtime_folder
from cairn.system.runtime_folder import check_length, private_folder, run_folder

NOBODY = 65534


@pytest.fixture
def user_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that stands for /run/user; no environment variable names a runtime folder."""
    monkeypatch.delenv("CAIRN_RUNTIME_DIR", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(runtime_folder, "_USER_FOLDERS", tmp_path)
    return tmp_path


def test_variables_name_the_runtime_folder_in_order(
    user_folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    uid = os.geteuid()
    assert runtime_folder.runtime_folder() == Path(f"/tmp/cairn-{uid}")

    (user_folders / str(uid)).mkdir()
    assert runtime_folder.runtime_folder() == user_folders / str(uid) / "cairn"

    monkeypatch.setenv("XDG_RUNTIME_DIR", "/x")
    assert runtime_folder.runtime_folder() == Path("/x/cairn")

    monkeypatch.setenv("CAIRN_RUNTIME_DIR", "/y")
    assert runtime_folder.runtime_folder() == Path("/y")


def test_empty_variables_count_as_unset(
    user_folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "")
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", "")

    assert runtime_folder.runtime_folder() == Path(f"/tmp/cairn-{os.geteuid()}")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a folder to another user")
def test_users_folder_of_another_user_is_not_used(user_folders: Path) -> None:
    folder = user_folders / str(os.geteuid())
    folder.mkdir()
    os.chown(folder, NOBODY, NOBODY)

    assert runtime_folder.runtime_folder() == Path(f"/tmp/cairn-{os.geteuid()}")


def test_folder_is_created_for_its_owner_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        private_folder(tmp_path / "new")
    finally:
        os.umask(before)

    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700


def _link(path: Path) -> None:
    (path.parent / "real").mkdir(mode=0o700)
    path.symlink_to(path.parent / "real")


def _file(path: Path) -> None:
    path.touch()


def _dangling_link(path: Path) -> None:
    path.symlink_to(path.parent / "nothing")


def _with_mode(mode: int) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        path.mkdir()
        path.chmod(mode)

    return make


def _of_another_user(path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root may give a folder to another user")
    path.mkdir(mode=0o700)
    os.chown(path, NOBODY, NOBODY)


def _below_a_folder_of_all(path: Path) -> None:
    path.mkdir(mode=0o700)
    path.parent.chmod(0o777)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (_link, "it is a link"),
        (_dangling_link, "cannot be created"),
        (_file, "cannot be created"),
        (_with_mode(0o755), "its mode 0755 lets other users in"),
        (_with_mode(0o770), "its mode 0770 lets other users in"),
        (_with_mode(0o701), "its mode 0701 lets other users in"),
        (_of_another_user, "it belongs to user 65534"),
        (_below_a_folder_of_all, "any user may replace it"),
    ],
)
def test_folder_that_others_could_use_is_refused_with_a_remedy(
    tmp_path: Path, make: Callable[[Path], None], reason: str
) -> None:
    folder = tmp_path / "folder"
    make(folder)

    with pytest.raises(CairnError, match=f"{folder}: .*{reason}.*set CAIRN_RUNTIME_DIR"):
        private_folder(folder)


def test_unknown_group_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"no group no_such_group .*groupadd no_such_group"):
        private_folder(tmp_path / "new", "no_such_group")


def test_too_long_a_path_of_a_socket_is_refused() -> None:
    assert check_length(Path("/" + "x" * 106))

    with pytest.raises(CairnError, match="has 108 bytes and may have 107; set CAIRN_RUNTIME_DIR"):
        check_length(Path("/" + "x" * 107))


def test_folder_of_a_run_is_removed_at_its_end_and_that_of_a_killed_run_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", str(tmp_path))
    killed = tmp_path / "run-killed"
    killed.mkdir()
    (killed / "base.sock").touch()

    with run_folder() as first:
        assert stat.S_IMODE(first.stat().st_mode) == 0o700
        with run_folder() as second:
            assert {*tmp_path.iterdir()} == {first, second}
    assert [*tmp_path.iterdir()] == []
