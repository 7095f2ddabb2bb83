"""Supervision in lockstep: the same restarts, escalation and exit code, in virtual time."""

import pytest

from cairn.testing.launching import Launching

pytestmark = pytest.mark.processes


def test_component_that_fails_is_restarted_as_often_as_virtual_time_allows(
    launch: Launching,
) -> None:
    run = launch(
        """
    components:
      talker: {plugin: test_talker, parameters: {words: 790}, restart: transient, significant: true}
      sentry: {plugin: test_sentry, parameters: {fail_after: 100}}
    """,
        "--lockstep",
    )

    assert run.await_end() == 0

    failed = run.await_line(
        "00:00:05.000 WARNING robot.root: child failed: sentry: receive .*: ValueError"
    )
    run.await_line("00:00:05.000 INFO    robot.root: child active: sentry", after=failed)
    assert sum("WARNING robot.root: child failed: sentry" in line for line in run.lines) == 7
    run.await_line("^ended.*: talker has finished: all words sent")


@pytest.mark.accuracy
def test_too_many_restarts_end_the_run_with_the_reason(launch: Launching) -> None:
    run = launch(
        """
    supervision: {max_restarts: 1}
    components:
      talker: {plugin: test_talker}
      sentry: {plugin: test_sentry, parameters: {fail_after: 3}}
    """,
        "--lockstep",
    )

    assert run.await_end() == 1

    run.await_line("robot.root: child stopped: talker: shut down")
    run.await_line(
        "cairn: deployment0.yaml failed: given up after more than 1 restarts within 10 s; "
        r"last, sentry: receive \(port words\): ValueError: received 3; logs: "
    )
