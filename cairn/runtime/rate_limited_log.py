"""Warnings that repeat, logged without flooding the log."""

from __future__ import annotations

import logging


class RateLimitedLog:
    """Logs the 1st, 2nd, 4th, 8th ... warning about each subject, and once that it is resolved.

    For conditions that a component meets again and again, such as an input that stays away.
    """

    def __init__(self, log: logging.Logger) -> None:
        """Write to `log`, usually a component's `self.log`."""
        self._log = log
        self._counts: dict[str, int] = {}

    def warn(self, subject: str, message: str) -> None:
        """Count a warning about `subject`; log the 1st, 2nd, 4th, 8th ... with the count."""
        count = self._counts[subject] = self._counts.get(subject, 0) + 1
        if count & (count - 1) == 0:
            repeated = f" ({count} times so far)" if count > 1 else ""
            self._log.warning("%s%s", message, repeated)

    def resolved(self, subject: str, message: str) -> None:
        """Reset the count of `subject`; log `message`, the state now, if there were warnings."""
        if self._counts.pop(subject, None) is not None:
            self._log.info("%s", message)
