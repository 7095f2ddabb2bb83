"""The results of runs, kept by the digests of their tasks."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Final

from cairn.errors import CairnError
from cairn.limits.files import read_bounded
from cairn.system.files import explain_os_error, private_files, replace_file
from cairn.system.runtime_folder import locked
from cairn.terminal.output import note
from cairn_lab.batch.task import MOST_RESULT_BYTES, pack, unpack_result

MOST_BYTES: Final = 4_000_000_000
"""Size of all entries [bytes]; beyond it, those that were not used for the longest are removed."""

_KEPT: Final = 0.9
"""Share of the size that is left then: not every further result removes an old one."""
_SUFFIX: Final = ".result"
_CHECK_BYTES: Final = 32


class ResultCache:
    """A folder with a file for each result, of limited size; several processes may use it.

    An entry begins with a digest of the task's key and of the rest. An entry that is torn, altered
    or renamed is not trusted: it counts as missing.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        """Create the folder; raises `CairnError` if that is not possible."""
        self.folder = folder
        self._most_bytes = most_bytes
        self._writable = True
        try:
            with private_files():
                folder.mkdir(parents=True, exist_ok=True)
            self._bytes = sum(size for _, size, _ in self._entries())
        except OSError as error:
            raise CairnError(
                f"{folder}: the results cannot be kept here: {explain_os_error(error)}, or use "
                "--cache FOLDER or --no-cache"
            ) from error

    def get(self, key: str) -> bytes | None:
        """Return an encoded result; None if there is none that can be trusted."""
        file = self._file(key)
        try:
            content = read_bounded(file, 2 * MOST_RESULT_BYTES)
        except OSError:  # not there, or not readable
            return None
        packed = content[_CHECK_BYTES:]
        if content[:_CHECK_BYTES] != _check(key, packed):
            return None
        try:
            result = unpack_result(packed)
        except ValueError:
            return None
        with suppress(OSError):  # of another user: it only looks older than it is
            os.utime(file)
        return result

    def put(self, key: str, result: bytes) -> None:
        """Keep an encoded result; if the disk takes no data, a note says so once."""
        packed = pack(result)
        content = _check(key, packed) + packed
        file = self._file(key)
        try:
            with private_files():
                file.parent.mkdir(exist_ok=True)
                with locked(self.folder):
                    replace_file(file, content, durable=False)
                    self._bytes += len(content)
                    if self._bytes > self._most_bytes:
                        self._remove_old()
        except OSError as error:
            if self._writable:
                self._writable = False
                note(
                    f"{self.folder}: results are not kept: {explain_os_error(error)}; the runs "
                    "continue"
                )

    def _file(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}{_SUFFIX}"

    def _entries(self) -> Iterator[tuple[float, int, Path]]:
        """Yield the time of the last use [s], size [bytes] and path of each entry."""
        for file in self.folder.glob(f"??/*{_SUFFIX}"):
            with suppress(FileNotFoundError):  # another process has removed it
                status = file.stat()
                yield status.st_mtime, status.st_size, file

    def _remove_old(self) -> None:
        entries = sorted(self._entries())
        self._bytes = sum(size for _, size, _ in entries)
        for _, size, file in entries:
            if self._bytes <= _KEPT * self._most_bytes:
                return
            file.unlink(missing_ok=True)
            self._bytes -= size


def _check(key: str, packed: bytes) -> bytes:
    return blake2b(packed, digest_size=_CHECK_BYTES, key=bytes.fromhex(key)).digest()
