"""Keeps what a record is told in a file too, so that it outlives the death of its process."""

import json
import logging
from pathlib import Path
from typing import IO

from cairn.components.report.record import RunRecord

Value = int | float | str | None | list["Value"]


class Journal:
    """Passes on what it is told to a record, and writes a line of JSON for each.

    Each line is handed to the system at once: what was told survives SIGKILL.
    """

    def __init__(self, record: RunRecord, file: Path, log: logging.Logger, *, resume: bool) -> None:
        """`resume`: first tell the record again what the file holds; else begin it anew.

        Raises `OSError` if the file cannot be opened.
        """
        self._record = record
        self._file = file
        self._log = log
        if resume and file.exists():
            self._retell()
        self._stream: IO[str] | None = file.open("a" if resume else "w", buffering=1)
        if resume:
            self._write("\n")  # the last line may have been cut off

    def tell(self, what: str, *values: Value) -> None:
        """Call the record's method `what`."""
        getattr(self._record, what)(*values)
        self._write(json.dumps([what, *values]) + "\n")

    def remove(self) -> None:
        """Close and remove the file: the report stands."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None
        self._file.unlink(missing_ok=True)

    def _retell(self) -> None:
        for line in self._file.read_text(encoding="utf-8").splitlines():
            try:
                what, *values = json.loads(line)
            except ValueError:  # cut off by the end of the process
                continue
            getattr(self._record, what)(*values)

    def _write(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(text)
        except OSError as error:  # the record goes on, and so does the robot
            self._log.warning(
                "%s cannot be written (%s): should this process be killed, the report is lost",
                self._file, error.strerror,
            )  # fmt: skip
            self._stream = None
