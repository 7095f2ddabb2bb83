"""Regression tests of recorded runs: a component must publish what it published then.

`cairn rerun --save-test` writes such tests:

    def test_localizer_publishes_what_was_recorded() -> None:
        assert_rerun_equal(Path(__file__).with_name("localizer_run.mcap"))

Where a change is meant to change what is published, a test can judge the messages itself:

    messages = rerun_messages(Path(__file__).with_name("localizer_run.mcap"), "localizer")
    assert max(one.covariance[0] for topic, _, one in messages if topic == "/robot/pose") < 0.1
"""

from pathlib import Path
from typing import Any

from cairn.recording.reader import McapRecording
from cairn.rerun.run import chosen_starts, prepared_rerun, starts_in

__all__ = ["assert_rerun_equal", "rerun_messages"]


def assert_rerun_equal(recording: Path, component: str | None = None) -> None:
    """Re-run what a recording holds, or one component of it, and compare what it publishes.

    Raises `AssertionError` with the first difference; `CairnError` if it cannot be re-run.
    """
    with McapRecording(recording) as opened:
        for start in chosen_starts(starts_in(opened), [component] if component else []):
            with prepared_rerun(opened, start, stop_at_difference=True) as rerun:
                result = rerun.run()
            assert result.first is None, f"{start.component}: {result.first}"
            assert not result.incomplete, f"{start.component}: {result.incomplete}"


def rerun_messages(recording: Path, component: str) -> list[tuple[str, int, Any]]:
    """Re-run a component; return what it publishes: topic, time [ns], message, in order.

    Raises `CairnError` if it cannot be re-run.
    """
    published: list[tuple[str, int, Any]] = []
    with McapRecording(recording) as opened:
        for start in chosen_starts(starts_in(opened), [component]):
            with prepared_rerun(opened, start) as rerun:
                rerun.run()
            published += rerun.published
    return published
