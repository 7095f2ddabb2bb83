"""What runs on the machine refuses archives that are cut off or hold anything but plain files."""

import io
import tarfile
from pathlib import Path

import pytest

from cairn.cli.releases.machine_side import RequestFailed, unpack


def archive(*members: tarfile.TarInfo) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w|") as written:
        for member in members:
            member.size = 2000 if member.isfile() else 0
            written.addfile(member, io.BytesIO(bytes(member.size)))
    return stream.getvalue()


def link(name: str) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = tarfile.SYMTYPE, "/etc"
    return member


@pytest.mark.parametrize(
    "member", [tarfile.TarInfo("release/../../x"), tarfile.TarInfo("/x"), link("release/etc")]
)
def test_only_plain_files_below_the_folder_are_unpacked(
    tmp_path: Path, member: tarfile.TarInfo
) -> None:
    with pytest.raises(RequestFailed, match="not a plain file"):
        unpack(io.BytesIO(archive(member)), tmp_path / "incoming")


def test_cut_off_archive_has_fewer_files_or_is_refused(tmp_path: Path) -> None:
    whole = archive(tarfile.TarInfo("release/a"), tarfile.TarInfo("release/b"))

    assert unpack(io.BytesIO(whole), tmp_path / "whole") == 2
    for length in (0, 1000, 2560, 4000):  # within a header or a file, and between two files
        try:
            count = unpack(io.BytesIO(whole[:length]), tmp_path / str(length))
        except RequestFailed:
            continue
        assert count < 2
