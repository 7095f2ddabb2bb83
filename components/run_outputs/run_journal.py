"""The journal of a report: its record on disk, so that it survives the death of its process."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO, Final

from pydantic import TypeAdapter, validate_call

from cairn import CairnError, RetriedSave
from cairn.components.run_outputs.run_record import RunRecord
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.system.files import explain_os_error, replace_file

Value = int | float | str | None | Sequence["Value"]

SLACK_BYTES: Final = 256_000
"""The file is rewritten when it is so much longer than after the last time [bytes]."""
_STATE: Final = "state"
_METHODS: Final = {name for name in vars(RunRecord) if name.startswith("record_")}
_RECORD: Final = TypeAdapter(RunRecord)


class RunJournal:
    """Records through a record's methods, and writes a line of JSON for each call.

    Each line is handed to the system at once: what was recorded survives SIGKILL. When the file is
    long, it is replaced by one line with the state of the record. While the disk takes no data,
    recording continues in memory; then the whole state is written.
    """

    def __init__(self, record: RunRecord, file: Path, saved: RetriedSave, *, resume: bool) -> None:
        """Open the file; with `resume`, first replay what it holds into the record.

        Raises `CairnError` if a file to resume from cannot be read.
        """
        self._record = record
        self._file = file
        self._saved = saved
        self._stream: BinaryIO | None = None
        self._size = self._rewrite_at = 0
        if resume and file.exists():
            self._replay()
        self._attempt(self._rewrite)

    def write(self, method: str, *values: Value) -> None:
        """Call a method of the record, and write the call to the file."""
        getattr(self._record, method)(*values)
        line = json.dumps([method, *values]).encode() + b"\n"
        if self._stream is None or self._size + len(line) > self._rewrite_at:
            self._attempt(self._rewrite)
        else:
            self._attempt(lambda: self._append(line))

    def remove(self) -> None:
        """Close and remove the file, as the report is written."""
        self._close()
        self._file.unlink(missing_ok=True)

    def _attempt(self, write: Callable[[], None]) -> None:
        lost = "what was recorded since this failed is lost"
        if not self._saved.attempt(write, lambda: lost):
            self._close()  # the file may end with a part of a line, and lacks others

    def _append(self, line: bytes) -> None:
        assert self._stream is not None
        if self._stream.write(line) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._file))
        self._size += len(line)

    def _rewrite(self) -> None:
        self._close()
        state = b'["%s", %s]\n' % (_STATE.encode(), _RECORD.dump_json(self._record))
        self._file.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self._file, state, durable=False)
        self._stream = self._file.open("ab", buffering=0)
        self._size, self._rewrite_at = len(state), len(state) + SLACK_BYTES

    def _close(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _replay(self) -> None:
        try:
            lines = read_bounded(self._file, STATE_BYTES).splitlines()
        except OSError as error:
            raise CairnError(f"report: {self._file}: {explain_os_error(error)}") from error
        checked = {name: validate_call(getattr(self._record, name)) for name in _METHODS}
        for line in lines:
            try:
                self._replay_line(checked, json.loads(line))
            except (ValueError, TypeError, ArithmeticError, RecursionError):
                continue  # cut off by the end of the process, or damaged

    def _replay_line(self, checked: Mapping[str, Callable[..., Any]], call: Any) -> None:
        match call:
            case [str(method), state] if method == _STATE:
                # Lax: JSON has lists for tuples, and text for the keys.
                stored = _RECORD.validate_python(state)
                for one in fields(RunRecord):
                    setattr(self._record, one.name, getattr(stored, one.name))
            case [str(method), *values] if method in _METHODS:
                checked[method](*values)
