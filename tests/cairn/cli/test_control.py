"""Commands that change a running deployment: parameters, loading, restarts."""

import pytest

from cairn.testing.launching import Run

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


def test_a_rejected_param_set_prints_the_reason(command: Command) -> None:
    command("param", "set", "talker", "volume=5")
    refusals = {
        "volume=11": "cairn: volume: the neighbors object to more than 10\n",
        "volume=12": "cairn: parameter volume = 12 rejected: should be less than or equal to 11 "
        "(allowed: >= 0, <= 11)\n",
        "volume=loud": "cairn: parameter volume = 'loud' rejected: should be a valid integer, "
        "unable to parse string as an integer (allowed: >= 0, <= 11)\n",
        "volme=3": "cairn: there is no parameter volme; did you mean volume?\n",
        "volume": "cairn: 'volume' is not a change; write NAME=VALUE\n",
    }
    for change, error in refusals.items():
        answer = command("param", "set", "talker", change)
        assert (answer.code, answer.err) == (1, error)
    assert command("param", "get", "talker", "volume").out == "5\n"


def test_unknown_names_are_reported_with_the_known_ones(command: Command) -> None:
    assert command("param", "get", "talker", "pitch").err == (
        "cairn: talker has no parameter pitch; it has words, volume\n"
    )
    missing = command("param", "list", "nobody")
    assert missing.code == 1
    assert missing.err.startswith("cairn: there is no nobody on the bus; there are: /rover/beacon")
    unknown = command("restart", "nobody")
    assert unknown.code == 1
    assert unknown.err.startswith("cairn: no supervisor has a component nobody; they have: ")
    lost = command("ps", "--robot", "tower")
    assert (lost.code, lost.err) == (
        1,
        "cairn: there is no robot tower on the bus; there are: rover\n",
    )


def test_a_component_is_loaded_restarted_and_unloaded_while_the_others_go_on(
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
    states = {row["component"]: row["state"] for row in command("ps", "--json").json}
    assert states["/rover/reader"] == "not loaded"
    assert [rover.pid_of(name) for name in ("mobile", "listener", "talker")] == others
