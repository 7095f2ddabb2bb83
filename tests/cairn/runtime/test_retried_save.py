"""Tests of saves that are retried: backoff, warnings, the status of the component."""

import errno

import pytest

from cairn import SECOND, Component, RetriedSave, every
from cairn.testing.lockstep import ComponentHarness
from tests.wording import assert_words


class Keeper(Component):
    """Saves ten times a second."""

    full = True

    def on_configure(self) -> None:
        """Note when it was attempted [s]."""
        self.saved = RetriedSave(self, "diary")
        self.attempts: list[float] = []

    @every(hz=10)
    def save(self) -> None:
        """Save, if an attempt is due."""
        self.saved.attempt(self._write, lambda: "12 pages are lost")

    def _write(self) -> None:
        self.attempts.append(round(self.clock.now() / SECOND - 1000.0, 1))
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device", "/disk/diary")


def test_failed_save_is_retried_with_growing_waits_and_shown(
    caplog: pytest.LogCaptureFixture,
) -> None:
    it = ComponentHarness(Keeper, {}, start_s=1000.0)
    it.run_for(30.0)

    keeper = it.component
    assert isinstance(keeper, Keeper)
    waits = [b - a for a, b in zip(keeper.attempts, keeper.attempts[1:], strict=False)]
    assert waits == pytest.approx([1.0, 2.0, 4.0, 8.0, 10.0], abs=0.11)
    assert it.ends == []
    warnings = [record for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == 3  # the 1st, 2nd and 4th
    assert_words(warnings[0].message, "/disk/diary", "No space left", "12 pages are lost")
    assert_words(it.runtime.status().reason, "diary not saved", "/disk/diary")

    keeper.full = False
    it.run_for(11.0)

    assert it.runtime.status().reason == ""
    assert len(keeper.attempts) > 10
