"""Which command the wheels are to carry out."""

from cairn.components.roboclaw.commanding import STILL, LatestCommand


def test_a_command_is_taken_until_it_is_stale() -> None:
    command = LatestCommand(0.3)
    assert command.take(0.0) == STILL
    command.give(1.0, 0.5, 0.1)

    assert command.take(1.0) == (0.5, 0.1)
    assert command.take(1.29) == (0.5, 0.1)
    assert command.take(1.31) == STILL


def test_what_waited_while_the_process_was_held_up_is_not_believed() -> None:
    command = LatestCommand(0.3)
    command.give(4.99, 0.5, 0.0)  # it has been waiting, and is handed out before this is known
    command.doubt(5.0)
    command.give(5.01, 0.5, 0.0)
    assert command.take(5.02) == STILL

    command.give(5.31, 0.2, 0.0)
    assert command.take(5.32) == (0.2, 0.0)


def test_a_forgotten_command_is_none() -> None:
    command = LatestCommand(0.3)
    command.give(1.0, 0.5, 0.0)
    command.forget()

    assert command.take(1.0) == STILL
