"""Warnings that repeat, logged without flooding the log."""

from __future__ import annotations

import logging
from typing import Final, NamedTuple

MOST_SUBJECTS: Final = 1_000
"""Subjects whose warnings are counted."""


class RateLimitedLog:
    """Logs the 1st, 2nd, 4th, 8th ... warning about each subject, and once that it is resolved.

    For conditions that a component meets again and again, such as an input that stays away. Of
    more than `MOST_SUBJECTS` subjects, such as invented names, it forgets the oldest one.
    """

    def __init__(self, log: logging.Logger) -> None:
        """Write to `log`, usually a component's `self.log`."""
        self._log = log
        self._counts: dict[str, _Repeated] = {}

    def warn(self, subject: str, message: str) -> None:
        """Count a warning about `subject`; log the 1st, 2nd, 4th, 8th ... with the count.

        The count is that of this very message, or else that of all warnings about the subject.
        """
        before = self._counts.get(subject, _Repeated("", 0, 0))
        same = before.same + 1 if message == before.message else 1
        now = self._counts[subject] = _Repeated(message, same, before.all + 1)
        if len(self._counts) > MOST_SUBJECTS:
            del self._counts[next(iter(self._counts))]
        if now.all & (now.all - 1) == 0:
            self._log.warning("%s%s", message, now, stacklevel=2)  # `LogLimit` counts by caller

    def resolved(self, subject: str, message: str) -> None:
        """Reset the count of `subject`; log `message`, the state now, if there were warnings."""
        if self._counts.pop(subject, None) is not None:
            self._log.info("%s", message)


class _Repeated(NamedTuple):
    """The last message about a subject, how often it came in a row, and the number of warnings."""

    message: str
    same: int
    all: int

    def __str__(self) -> str:
        """Return what is logged after the message."""
        if self.same > 1:
            return f" ({self.same} times so far)"
        return f" ({self.all} warnings so far)" if self.all > 1 else ""
