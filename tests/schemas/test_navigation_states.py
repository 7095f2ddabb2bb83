"""The names of an order's states, and which of them are its result."""

from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    NavigationStatus,
    without_numbers,
)


def test_every_state_is_called_as_its_constant() -> None:
    constants = {
        value: name.lower()
        for name, value in vars(NavigationStatus).items()
        if name.isupper() and isinstance(value, int)
    }
    assert constants == NAVIGATION_STATES


def test_the_results_are_the_last_states() -> None:
    assert {NAVIGATION_STATES[state] for state in NAVIGATION_END_STATES} == {
        "succeeded",
        "failed",
        "canceled",
    }


def test_a_reason_that_differs_in_its_numbers_alone_is_no_news() -> None:
    older, newer = (f"no scan for {age} s on /robot/scan" for age in (0.8, 12.31))
    assert without_numbers(older) == without_numbers(newer)
    assert without_numbers(older) != without_numbers("no odom for 0.8 s on /robot/odom")
