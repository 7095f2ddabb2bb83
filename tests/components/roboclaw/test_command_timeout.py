"""The command timeout: only fresh commands move the wheels."""

from cairn.components.roboclaw.command_timeout import REST, LatestCommand


def test_command_is_used_until_it_is_stale() -> None:
    command = LatestCommand(0.3)
    assert command.current(0.0) == REST
    command.set(1.0, 0.5, 0.1)

    assert command.current(1.0) == (0.5, 0.1)
    assert command.current(1.29) == (0.5, 0.1)
    assert command.current(1.31) == REST


def test_commands_that_queued_while_the_process_was_held_up_are_ignored() -> None:
    command = LatestCommand(0.3)
    command.set(4.99, 0.5, 0.0)  # it was queued, and is delivered before the delay is noticed
    command.ignore_queued(5.0)
    command.set(5.01, 0.5, 0.0)
    assert command.current(5.02) == REST

    command.set(5.31, 0.2, 0.0)
    assert command.current(5.32) == (0.2, 0.0)


def test_cleared_command_is_rest() -> None:
    command = LatestCommand(0.3)
    command.set(1.0, 0.5, 0.0)
    command.clear()

    assert command.current(1.0) == REST
