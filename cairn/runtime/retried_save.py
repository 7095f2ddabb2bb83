"""Saves a component's data, and retries while the disk takes none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from cairn.errors import CairnError
from cairn.runtime.component import Component
from cairn.runtime.rate_limited_log import RateLimitedLog
from cairn.system.clock import SECOND
from cairn.system.files import explain_os_error

_LONGEST_WAIT_S: Final = 10.0
"""The time between two attempts grows from 1 s to this [s]."""


class RetriedSave:
    """Saves one thing that a component keeps, such as its map; a failure does not fail it.

    After a failure it waits 1 s, 2 s, 4 s, ... at most 10 s until the next attempt. Meanwhile the
    component keeps what it has to save, within bounds of its own. The failure is in a rate-limited
    warning and in the component's status (`cairn ps`).
    """

    def __init__(self, component: Component, subject: str) -> None:
        """Save `subject`, a name for messages such as "visual map"."""
        self._component = component
        self._subject = subject
        self._warnings = RateLimitedLog(component.log)
        self._wait_s = 0.0
        self.due_ns = 0  # of the next attempt, by the component's clock; 0 after a success

    @property
    def has_failed(self) -> bool:
        """Whether the last attempt failed."""
        return self._wait_s > 0.0

    def attempt(
        self, write: Callable[[], None], lost: Callable[[], str], *, now: bool = False
    ) -> bool:
        """Call `write` if an attempt is due, or in any case with `now`; return whether it saved.

        `write` raises `OSError` or `CairnError` if it cannot save. `lost` returns what is lost if
        the process ends before the next attempt succeeds, for the warning.
        """
        at = self._component.clock.now()
        # A clock that was set back must not delay the next attempt.
        waits = at < self.due_ns <= at + round(_LONGEST_WAIT_S * SECOND)
        if waits and not now:
            return False
        try:
            write()
        except (OSError, CairnError) as error:
            self._failed(at, error, lost())
            return False
        if self.has_failed:
            self._wait_s, self.due_ns = 0.0, 0
            self._component.report_problem(self._subject, None)
            self._warnings.resolved(self._subject, f"{self._subject} saved again")
        return True

    def _failed(self, at: int, error: OSError | CairnError, lost: str) -> None:
        self._wait_s = min(2.0 * self._wait_s, _LONGEST_WAIT_S) or 1.0
        self.due_ns = at + round(self._wait_s * SECOND)
        reason = str(error)
        if isinstance(error, OSError):
            file = f"{error.filename}: " if error.filename else ""
            reason = f"{file}{explain_os_error(error)}"
        problem = f"{self._subject} not saved: {reason.rstrip('.')}"
        self._component.report_problem(self._subject, problem)
        self._warnings.warn(
            self._subject,
            f"{problem}; if this process ends now, {lost}; next attempt in {self._wait_s:.0f} s",
        )
