"""The names of a goal's states, and which of them are results."""

from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    NavigationStatus,
)


def test_state_names_equal_the_names_of_their_constants() -> None:
    constants = {
        value: name.lower()
        for name, value in vars(NavigationStatus).items()
        if name.isupper() and isinstance(value, int)
    }
    assert constants == NAVIGATION_STATES


def test_results_are_the_last_states() -> None:
    assert {NAVIGATION_STATES[state] for state in NAVIGATION_END_STATES} == {
        "succeeded",
        "failed",
        "canceled",
    }
