"""The trajectory files of a report: every pose of a run, in the format of TUM."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import BinaryIO, Final

from cairn import RetriedSave
from cairn.recording.tum import TUM_HEADER, tum_line
from cairn.schemas.geometry_msgs import Pose
from cairn.system.files import TAKES_NO_DATA

WAITING_BYTES: Final = 4_000_000
"""Lines kept in memory while the disk takes none: more than an hour of poses at 10 Hz [bytes]."""
_BLOCK: Final = 4096


class TrajectoryFile:
    """Appends poses to a file as they arrive; it is created with the first one.

    Each line is handed to the system at once, so that it survives SIGKILL. While the disk takes no
    data, lines wait in memory, within `WAITING_BYTES`.
    """

    def __init__(self, file: Path, saved: RetriedSave, *, resume: bool) -> None:
        """Continue the file of an earlier process of the same run with `resume`, else replace it.

        Raises `OSError` if the file of an earlier run cannot be removed, now or when the disk takes
        data again.
        """
        self._file = file
        self._saved = saved
        self._stream: BinaryIO | None = None
        self._waiting = bytearray()
        self.omitted = 0
        """Poses that were lost because too many waited for the disk."""
        self._replace = not resume
        if self._replace:
            try:
                file.unlink(missing_ok=True)
                self._replace = False
            except OSError as error:
                if error.errno not in TAKES_NO_DATA:
                    raise

    def add(self, stamp_ns: int, pose: Pose) -> bool:
        """Write a pose; return False if it is lost, because too many wait for the disk."""
        position, turn = pose.position, pose.orientation
        line = tum_line(
            stamp_ns, (position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w)
        ).encode()
        kept = len(self._waiting) + len(line) <= WAITING_BYTES
        if kept:
            self._waiting += line
        else:
            self.omitted += 1
        self._attempt()
        return kept

    def close(self) -> None:
        """Write what waits, and close the file."""
        if self._waiting:
            self._attempt(now=True)
        self._close()

    def _attempt(self, *, now: bool = False) -> None:
        if not self._saved.attempt(self._write, self._lost, now=now):
            self._close()

    def _lost(self) -> str:
        poses = self._waiting.count(b"\n") + self.omitted
        return f"{poses} poses are missing in {self._file.name}"

    def _write(self) -> None:
        if self._stream is None:
            self._stream = self._opened()
        end = self._stream.seek(0, os.SEEK_END)
        written = self._stream.write(self._waiting)
        if written < len(self._waiting):
            self._stream.truncate(end)  # no part of a line stays
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._file))
        self._waiting.clear()

    def _opened(self) -> BinaryIO:
        """Open the file at its end, without a part of a line that a killed process has left."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        stream = open(descriptor, "r+b", buffering=0)  # noqa: SIM115 - stays open
        try:
            if self._replace:
                stream.truncate(0)
                self._replace = False
            size = stream.seek(0, os.SEEK_END)
            stream.seek(max(0, size - _BLOCK))
            whole = max(0, size - _BLOCK) + (stream.read(_BLOCK).rfind(b"\n") + 1)
            stream.truncate(whole)
            stream.seek(whole)
            if not whole and stream.write(TUM_HEADER.encode()) < len(TUM_HEADER):
                stream.truncate(0)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._file))
        except BaseException:
            stream.close()
            raise
        return stream

    def _close(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
