"""Commands that change a running deployment: parameters, loading, restarts."""

import pytest

from cairn.testing.launching import Run
from tests.commands import await_status
from tests.wording import assert_words

from .conftest import Command

pytestmark = pytest.mark.processes


def test_param_list_prints_value_bounds_and_meaning(command: Command) -> None:
    rows = {row["name"]: row for row in command("param", "list", "talker", "--json").json}

    assert rows["volume"]["bounds"] == ">= 0, <= 11"
    assert rows["volume"]["description"].startswith("Loudness [1]")
    assert "volume" in command("param", "list", "talker").out


def test_param_set_changes_a_running_component(command: Command) -> None:
    changed = command("param", "set", "talker", "volume=7")

    assert (changed.code, changed.out) == (0, "talker.volume = 7\n")
    assert command("param", "get", "talker", "volume").out == "7\n"


def test_rejected_param_set_prints_the_reason(command: Command) -> None:
    command("param", "set", "talker", "volume=5")
    refusals = {
        "volume=11": ["volume: the neighbors object to more than 10"],
        "volume=12": ["volume = 12 rejected", "less than or equal to 11", "(allowed: >= 0, <= 11)"],
        "volume=loud": ["volume = 'loud' rejected", "integer", "(allowed: >= 0, <= 11)"],
        "volme=3": ["parameter volme", "did you mean volume?"],
        "volume": ["'volume' is not", "NAME=VALUE"],
    }
    for change, words in refusals.items():
        answer = command("param", "set", "talker", change)
        assert answer.code == 1
        assert answer.err.startswith("cairn: ")
        assert answer.err.count("\n") == 1
        assert [word for word in words if word not in answer.err] == []
    assert command("param", "get", "talker", "volume").out == "5\n"


def test_unknown_names_are_reported_with_the_known_ones(command: Command) -> None:
    assert_words(
        command("param", "get", "talker", "pitch").err, "cairn: talker", "pitch", "words, volume"
    )
    missing = command("param", "list", "absent")
    assert missing.code == 1
    assert "absent" in missing.err
    assert ": /rover/beacon" in missing.err
    unknown = command("restart", "absent")
    assert unknown.code == 1
    assert "there is no absent on the bus" in unknown.err
    assert "beacon" in unknown.err
    assert_words(command("restart", "root").err, "/rover/root", "no supervisor", "`cairn up`")
    lost = command("ps", "--robot", "tower")
    assert lost.code == 1
    assert "robot tower" in lost.err
    assert lost.err.endswith(": rover\n")


def test_component_is_loaded_restarted_and_unloaded_while_the_others_continue(
    command: Command, rover: Run
) -> None:
    others = [rover.pid_of(name) for name in ("mobile", "listener", "talker")]
    seen = len(rover.lines)

    assert command("load", "reader").out == "reader: active\n"
    reader = rover.pid_of("reader")
    rover.await_line("reader: the beacon stands at 4, 2", after=seen)
    assert command("load", "reader").out == "reader: active\n"
    assert rover.pid_of("reader") == reader

    assert command("restart", "reader").out == "reader: active\n"
    assert rover.pid_of("reader") != reader

    assert command("unload", "reader").out == "reader: unloaded\n"
    await_status("/rover/reader", lambda row: row["state"] == "not loaded", rover.endpoint)
    assert [rover.pid_of(name) for name in ("mobile", "listener", "talker")] == others
