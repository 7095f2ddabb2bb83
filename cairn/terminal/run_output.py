"""The printed lines of a running robot, which continues when they cannot be written."""

import logging
import os
import sys

from cairn.terminal.output import OutputLost, line

_NOT_WRITTEN = "the output could not be written"


class RunOutput:
    """The lines of a run, which continues when they cannot be written: its log has them as well.

    After a full disk it prints how many are missing. When the reader has ended, it prints no more.
    """

    def __init__(self) -> None:
        self._missing = 0
        self._logged = False
        self._ended = False

    def line(self, text: str) -> None:
        """Print one line if possible; log the first failure."""
        if self._ended:
            return
        try:
            if self._missing:
                line(f"({self._missing} lines are missing here: {_NOT_WRITTEN})")
                self._missing, self._logged = 0, False
            line(text)
        except (BrokenPipeError, OutputLost) as error:
            self._missing += 1
            log = logging.getLogger("cairn")
            if not self._logged and log.hasHandlers():  # the log is opened after the first line
                self._logged = True
                log.warning("output of cairn up lost: %s; the robot continues", error)
            self._ended = self._logged and isinstance(error, BrokenPipeError)

    def close(self) -> None:
        """Discard what cannot be written, so that it does not change the exit code."""
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except OSError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
