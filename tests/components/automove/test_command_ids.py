"""Goal ids are never reused, whichever process restarts."""

from hypothesis import given
from hypothesis import strategies as st

from cairn.components.automove.state_machine import CommandIds

NOW = 1_795_261_862_000_000_000
UINT32 = 2**32


@given(st.lists(st.integers(0, 3_000_000), min_size=1, max_size=200))
def test_command_ids_are_unique_and_fit_the_message(
    steps: list[int],
) -> None:
    command_ids, now, given_out = CommandIds(), NOW, []
    for step in steps:
        now += step
        given_out.append(command_ids.next(now))
    assert len(set(given_out)) == len(given_out)
    assert all(0 < command_id < UINT32 for command_id in given_out)


def test_restarted_process_uses_larger_command_ids() -> None:
    forerunner = CommandIds()
    given_out = [forerunner.next(NOW + ms * 1_000_000) for ms in range(0, 100, 2)]
    assert CommandIds().next(NOW + 100_000_000) not in given_out


def test_command_ids_continue_after_overflow_and_clock_set_back() -> None:
    wrap = (UINT32 - 1) * 1_000_000
    command_ids = CommandIds()
    assert [command_ids.next(wrap), command_ids.next(wrap), command_ids.next(wrap)] == [
        UINT32 - 1,
        1,
        2,
    ]
    assert command_ids.next(wrap - 10_000_000) == 3


def test_first_command_id_in_virtual_time_is_one() -> None:
    assert CommandIds().next(0) == 1
