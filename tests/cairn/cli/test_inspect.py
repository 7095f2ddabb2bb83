"""Commands that inspect a running deployment: ps, graph, topic, logs."""

import json
import subprocess

import pytest
import zenoh

from cairn.bus import keys
from cairn.bus.session import open_peer
from cairn.runtime.rosout import ROSOUT
from cairn.schemas.rcl_interfaces import Log
from cairn.testing.launching import CAIRN, LIMIT_S, Run
from tests.commands import await_status

from .conftest import Command

pytestmark = pytest.mark.processes


def test_ps_shows_the_tree_of_components(command: Command, rover: Run) -> None:
    shown = command("ps")

    assert (shown.code, shown.err) == (0, "")
    header, *rows = shown.out.splitlines()
    assert header.split() == (
        ["component", "state", "pid", "restarts", "received", "dropped", "MiB", "CPU", "s", "note"]
    )
    assert [row[:14].rstrip() for row in rows] == [
        "root",
        "  mobile",
        "    listener",
        "    reader",
        "  beacon",
        "  talker",
    ]
    assert rows[3].endswith(" not loaded")
    assert all(row.split()[1] == "active" for row in rows if row != rows[3])
    assert max(map(len, rows)) <= 100


def test_ps_as_json_has_the_details_of_each_component(command: Command, rover: Run) -> None:
    await_status("/rover/listener", lambda row: row["received"] > 0, rover.endpoint)

    rows = {row["component"]: row for row in command("ps", "--json").json}

    listener = rows["/rover/listener"]
    assert listener["pid"] == rover.pid_of("listener")
    assert listener["plugin"] == "test_listener"
    assert (listener["parent"], listener["placement"]) == ("mobile", "process")
    assert (listener["state"], listener["restarts"], listener["dropped"]) == ("active", 0, 0)
    assert listener["memory_mib"] > 1
    assert rows["/rover/root"]["pid"] == rover.process.pid


def test_graph_lists_publishers_and_subscribers_of_each_topic(command: Command) -> None:
    rows = {row["topic"]: row for row in command("graph", "--json").json}

    assert rows["/rover/words"] == {
        "topic": "/rover/words",
        "type": "geometry_msgs/msg/Twist",
        "publishers": ["talker"],
        "subscribers": ["listener"],
    }
    assert "/rosout" not in rows
    every = {row["topic"]: row for row in command("graph", "--all", "--json").json}
    assert "/rover/beacon" in every["/rosout"]["publishers"]
    table = command("graph").out
    lines = [" ".join(row.split()) for row in table.splitlines()]
    assert "/rover/words geometry_msgs/msg/Twist talker listener" in lines


def test_topic_list_counts_publishers_and_subscribers(command: Command) -> None:
    rows = {row["topic"]: row for row in command("topic", "list", "--json").json}

    assert (rows["/rover/words"]["publishers"], rows["/rover/words"]["subscribers"]) == (1, 1)
    assert "/rover/beacon" in command("topic", "list").out


def test_topic_echo_prints_messages(command: Command) -> None:
    latched = command("topic", "echo", "beacon", "--count", "1", "--json")
    passing = command("topic", "echo", "/rover/words", "--count", "2")

    assert latched.json["pose"]["position"] == {"x": 4.0, "y": 2.0, "z": 0.0}
    assert passing.out.count("linear: {x: ") == 2
    assert passing.out.count("---\n") == 2


def test_topic_echo_of_a_silent_topic_times_out(command: Command) -> None:
    answer = command("topic", "echo", "velocity", "--wait", "0.1")
    silent = command("topic", "echo", "/rover/goal_pose", "--wait", "0.1")

    assert answer.code == 1
    assert "velocity" in answer.err
    assert ": /rosout, " in answer.err
    assert silent.code == 1


def test_topic_hz_measures_the_rate(command: Command) -> None:
    result = command("topic", "hz", "words", "--seconds", "1", "--json").json

    assert result["topic"] == "/rover/words"
    assert result["messages"] >= 2
    assert result["hz"] > 0
    assert result["bytes"] == 52
    assert result["lost"] == 0
    assert "longest ms" in command("topic", "hz", "words", "--seconds", "0.5").out


def test_logs_prints_the_last_messages(command: Command) -> None:
    everything = command("logs").out
    one = command("logs", "listener", "--json").out.splitlines()

    assert "INFO    rover.root: child active: talker\n" in everything
    assert json.loads(one[0])["name"] == "rover.listener"
    assert json.loads(one[0])["message"] == "received 1, the last was 1"


def test_logs_reports_a_component_that_does_not_answer(command: Command, rover: Run) -> None:
    kept = f"{keys.message_key(0, ROSOUT, Log)}/@adv/pub/hangs"
    unanswered: list[zenoh.Query] = []
    with (
        open_peer([rover.endpoint]) as session,
        session.declare_queryable(kept, unanswered.append),
    ):
        printed = command("logs")
        for query in unanswered:
            query.drop()

    assert unanswered
    assert "INFO    rover.root: child active: talker\n" in printed.out
    assert "a component does not answer" in printed.err
    assert "logs/" in printed.err


def test_logs_follow_continues_until_ctrl_c(rover: Run) -> None:
    with subprocess.Popen(
        [CAIRN, "logs", "--follow", "listener", "--connect", rover.endpoint],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as follower:
        assert follower.stdout is not None
        assert follower.stderr is not None
        seen = len(rover.lines)
        now = rover.lines[rover.await_line("received", after=seen) - 1]
        for line in follower.stdout:
            if line > now and "received" in line:
                break
        follower.send_signal(2)
        assert follower.wait(LIMIT_S) == 130
        assert follower.stderr.read() == ""
