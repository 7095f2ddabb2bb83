"""Repeated warnings are logged less and less often, and once when they are resolved."""

import logging

import pytest

from cairn import RateLimitedLog


@pytest.fixture
def warnings(caplog: pytest.LogCaptureFixture) -> RateLimitedLog:
    caplog.set_level(logging.INFO)
    return RateLimitedLog(logging.getLogger("cairn.test"))


def test_first_second_fourth_and_eighth_warning_are_logged_with_their_count(
    warnings: RateLimitedLog, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(1, 11):
        warnings.warn("scan", f"no scan {number}")

    assert caplog.messages == [
        "no scan 1",
        "no scan 2 (2 warnings so far)",
        "no scan 4 (4 warnings so far)",
        "no scan 8 (8 warnings so far)",
    ]


def test_count_is_that_of_the_message_as_long_as_it_stays_the_same(
    warnings: RateLimitedLog, caplog: pytest.LogCaptureFixture
) -> None:
    warnings.warn("device", "the line is gone")
    for _ in range(3):
        warnings.warn("device", "the line cannot be opened")

    assert caplog.messages == [
        "the line is gone",
        "the line cannot be opened (2 warnings so far)",
        "the line cannot be opened (3 times so far)",
    ]


def test_resolved_is_logged_once_and_resets_the_count_of_its_subject_alone(
    warnings: RateLimitedLog, caplog: pytest.LogCaptureFixture
) -> None:
    warnings.resolved("scan", "scans are received")
    warnings.warn("scan", "no scan")
    warnings.warn("odom", "no odometry")
    for _ in range(2):
        warnings.resolved("scan", "scans are received")
    warnings.warn("scan", "no scan")
    warnings.warn("odom", "no odometry")

    assert caplog.messages == [
        "no scan",
        "no odometry",
        "scans are received",
        "no scan",
        "no odometry (2 times so far)",
    ]
