"""The command timeout: only fresh commands move the wheels."""

from cairn.driver.command_timeout import LatestCommand


def test_command_is_used_until_it_is_stale() -> None:
    command = LatestCommand(0.3)
    assert command.fresh(0.0) is None
    command.set(1.0, 0.5, 0.1)

    assert command.fresh(1.0) == (0.5, 0.1)
    assert command.fresh(1.29) == (0.5, 0.1)
    assert command.fresh(1.31) is None


def test_command_that_arrives_after_the_reader_took_the_time_is_fresh() -> None:
    command = LatestCommand(0.3)
    command.set(1.001, 0.5, 0.1)

    assert command.fresh(1.0) == (0.5, 0.1)


def test_command_is_stale_after_the_clock_was_set_back() -> None:
    command = LatestCommand(0.3)
    command.set(10.0, 0.5, 0.1)

    assert command.fresh(1.0) is None


def test_commands_that_queued_while_the_process_was_held_up_are_ignored() -> None:
    command = LatestCommand(0.3)
    command.set(4.99, 0.5, 0.0)  # it was queued, and is delivered before the delay is noticed
    command.ignore_queued(5.0)
    command.set(5.01, 0.5, 0.0)
    assert command.fresh(5.02) is None

    command.set(5.31, 0.2, 0.0)
    assert command.fresh(5.32) == (0.2, 0.0)


def test_cleared_command_is_not_fresh() -> None:
    command = LatestCommand(0.3)
    command.set(1.0, 0.5, 0.0)
    command.clear()

    assert command.fresh(1.0) is None
