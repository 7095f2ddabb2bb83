"""What a component complains of again and again, told without flooding its log."""

from __future__ import annotations

import logging


class RateLimitedLog:
    """Counts complaints by what they are about, and logs some of them."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._told: dict[str, int] = {}

    def resolved(self, about: str, what: str) -> None:
        """Note that there is nothing to complain of: the next time is a first one.

        If there was, `what` is logged: how it is now.
        """
        if self._told.pop(about, None) is not None:
            self._log.info("%s", what)

    def warn(self, about: str, what: str) -> None:
        """Log the 1st, 2nd, 4th, 8th ... complaint about something."""
        count = self._told[about] = self._told.get(about, 0) + 1
        if count & (count - 1) == 0:
            so_often = f" ({count} times so far)" if count > 1 else ""
            self._log.warning("%s%s", what, so_often)
