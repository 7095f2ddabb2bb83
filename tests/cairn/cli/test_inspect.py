"""Commands that inspect a running deployment: ps, graph, topic, logs."""

import json
import os
import re
import signal
import subprocess
import time
from contextlib import ExitStack
from dataclasses import replace

import psutil
import pytest
import zenoh

from cairn import LATCHED
from cairn.bus import keys
from cairn.bus.discovery import QueryableWatcher
from cairn.bus.session import open_client, open_peer
from cairn.bus.type_hash import type_hash
from cairn.client import Subscription, connect, connection
from cairn.runtime.rosout import ROSOUT
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.message import type_name
from cairn.schemas.rcl_interfaces import Log
from cairn.terminal import completion
from cairn.testing.launching import CAIRN, LIMIT_S, Run
from tests.cairn.bus.network import eventually
from tests.commands import Answer, all_answered, await_answer, await_status, quick_answer
from tests.wording import assert_words

from .conftest import Command

pytestmark = pytest.mark.processes


def test_ps_shows_the_tree_of_components(command: Command, rover: Run) -> None:
    shown = await_answer(lambda: command("ps"), all_answered)

    assert (shown.code, shown.err) == (0, "")
    header, *rows = shown.out.splitlines()
    columns = "component state pid restarts recv dropped invalid refused MiB CPU s note"
    assert " ".join(header.split()) == columns
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
    # On a busy computer a note may say that a component is silent.
    assert header.index("note") + len("not loaded") <= 100


@pytest.mark.realtime
def test_ps_lists_what_does_not_answer_without_waiting_for_it(command: Command, rover: Run) -> None:
    session_of = f"{keys.CAIRN_ID_PREFIX}{1:08x}0000000000000001"
    ghost = keys.NodeEntity(0, session_of, 0, "/rover/ghost")
    topic = "/rover/component_status"
    with open_peer([rover.endpoint]) as session, ExitStack() as stack:
        hashed = type_hash(ComponentStatus)
        for number in range(300):
            name = f"/rover/ghost{number}" if number else "/rover/ghost"
            node = replace(ghost, node_id=number, name=name)
            kind = type_name(ComponentStatus)
            end = keys.EndpointEntity(node, 1, "MP", topic, kind, hashed, LATCHED)
            token = session.liveliness().declare_token(keys.token_key(end))
            stack.callback(token.undeclare)
        with connect(rover.endpoint) as robot:

            def are_announced() -> bool:
                known = robot.connection.endpoints(topic)
                return sum("ghost" in one.node.name for one in known) == 300

            assert eventually(are_announced)
        # 5 s and more, if it waited for each robot's.
        answer = quick_answer(lambda: command("ps", "--json"), 4.0)

    rows = {row["component"]: row for row in answer.json}
    assert (rows["/rover/ghost"]["state"], rows["/rover/ghost"]["pid"]) == ("no answer", 1)
    assert rows["/rover/talker"]["state"] == "active"
    assert sum(row["state"] == "no answer" for row in rows.values()) == 100
    assert "200 more announced components do not answer" in answer.err


def test_statuses_do_not_wait_for_announced_publishers_that_do_not_exist(
    rover: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    topic, kind = "/rover/component_status", type_name(ComponentStatus)
    node = keys.NodeEntity(0, "ab", 0, "/rover/ghost")
    ghost = keys.EndpointEntity(node, 1, "MP", topic, kind, type_hash(ComponentStatus), LATCHED)
    with open_peer([rover.endpoint]) as session, connect(rover.endpoint) as robot:
        token = session.liveliness().declare_token(keys.token_key(ghost))
        assert eventually(lambda: ghost in robot.connection.endpoints(topic))
        assert "/rover/ghost" in robot.connection.read_statuses().silent
        for limit in ("_CACHES_FIRST_S", "_STATUS_LIMIT_S"):  # on a busy computer, too
            monkeypatch.setattr(connection, limit, LIMIT_S)
        monkeypatch.setattr(connection, "read_graph", _fail)
        assert "/rover/talker" in robot.connection.statuses()
        token.undeclare()


def test_ps_shows_the_other_components_beside_a_stopped_one(command: Command, rover: Run) -> None:
    talker = rover.pid_of("talker")

    def ps() -> Answer:
        os.kill(talker, signal.SIGSTOP)
        try:
            # Until all of its threads have stopped, it may still answer.
            status = psutil.Process(talker).status
            assert eventually(lambda: status() == psutil.STATUS_STOPPED)
            return command("ps", "--json")
        finally:
            os.kill(talker, signal.SIGCONT)  # after 8 s it would count as hung

    def only_it_is_silent(answer: Answer) -> bool:
        rows = {row["component"]: row["state"] for row in answer.json}
        silent = [name for name, state in rows.items() if state == "no answer"]
        return silent == ["/rover/talker"] and rows["/rover/listener"] == "active"

    await_answer(ps, only_it_is_silent)


def test_ps_as_json_has_the_details_of_each_component(command: Command, rover: Run) -> None:
    await_status("/rover/listener", lambda row: row["received"] > 0, rover.endpoint)

    answer = await_answer(lambda: command("ps", "--json"), all_answered)

    rows = {row["component"]: row for row in answer.json}
    listener = rows["/rover/listener"]
    assert listener["pid"] == rover.pid_of("listener")
    assert listener["plugin"] == "test_listener"
    assert (listener["parent"], listener["placement"]) == ("mobile", "process")
    assert (listener["state"], listener["restarts"]) == ("active", 0)
    assert listener["memory_mib"] > 1
    # A listener that gets no processor for half a second drops words: its queue is short.
    assert listener["dropped"] >= 0
    supervisor = rows["/rover/mobile"]  # it reads heartbeats on private channels, not on the bus
    assert (supervisor["received"], supervisor["dropped"]) == (0, 0)
    assert rows["/rover/root"]["pid"] == rover.process.pid


@pytest.mark.parametrize(
    "arguments",
    [("ps",), ("topic", "list"), ("graph",), ("topic", "echo", "words"), ("go", "1", "2")],
)
def test_command_in_an_empty_domain_names_the_others(
    command: Command, arguments: tuple[str, ...]
) -> None:
    answer = command(*arguments, "--domain", "5")

    assert_words(answer.out + answer.err, "this router has nodes in domain 0: give --domain 0")


def test_graph_lists_publishers_and_subscribers_of_each_topic(command: Command) -> None:
    rows = {row["topic"]: row for row in command("graph", "--json").json}

    assert rows["/rover/words"] == {
        "topic": "/rover/words",
        "type": "geometry_msgs/msg/Twist",
        "publishers": ["talker"],
        "subscribers": ["listener"],
        "foreign": [],
        "problems": [],
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


def test_topic_echo_finds_topics_that_lists_leave_out_by_their_short_names(
    command: Command,
) -> None:
    status = command("topic", "echo", "component_status", "--count", "1", "-f", "state")

    assert status.out == "active\n"


def test_topic_echo_prints_fields_as_rows(command: Command) -> None:
    one = command("topic", "echo", "beacon", "--count", "1", "-f", "pose.position.x")
    several = ("-f", "pose.position.x", "-f", "header.frame_id")
    rows = command("topic", "echo", "beacon", "--count", "1", *several)

    assert one.out == "4.0\n"
    assert rows.out.splitlines()[0] == "pose.position.x,header.frame_id"
    assert rows.out.splitlines()[1].startswith("4.0,")


def test_topic_pub_publishes_with_the_type_of_the_topic_until_ctrl_c(
    command: Command, rover: Run
) -> None:
    publish = ["topic", "pub", "words", "{linear: {x: -7}}", "--rate", "20"]
    with (
        connect(rover.endpoint) as robot,
        robot.subscribe("words", Twist) as words,
        subprocess.Popen(
            [CAIRN, *publish, "--connect", rover.endpoint], stdout=subprocess.PIPE, text=True
        ) as publisher,
    ):
        deadline = time.monotonic() + LIMIT_S
        received = 0
        while received < 2:  # with the second one, the first is counted
            received += words.next().linear.x == -7.0
            assert time.monotonic() < deadline
        publisher.send_signal(signal.SIGINT)
        printed, _ = publisher.communicate(timeout=LIMIT_S)
    once = command("topic", "pub", "words", "{linear: {x: -7}}")
    unknown = command("topic", "pub", "word", "{}")

    assert publisher.returncode == 130
    assert re.search(r"published .* of type geometry_msgs/msg/Twist on /rover/words", printed)
    assert "published a message" in once.out
    assert "did you mean /rover/words?" in unknown.err


def test_missing_topic_is_reported_with_those_that_exist(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(completion, "_LIMIT_S", LIMIT_S)  # on a busy computer, too
    error = command("topic", "hz").err

    assert "Missing argument 'TOPIC'" in error
    assert "beacon" in error


@pytest.mark.parametrize(
    ("machine", "who"),
    [("", ": over the network, your role"), ("base", ": this machine (its `role` in the deploy")],
)
def test_echo_reports_messages_that_are_published_but_do_not_arrive(
    machine: str, who: str, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Subscription, "_receive", lambda *_: None)  # as if the role forbade it
    statuses = connection.Connection.statuses
    monkeypatch.setattr(
        connection.Connection,
        "statuses",
        lambda self: {name: replace(one, machine=machine) for name, one in statuses(self).items()},
    )

    deadline = time.monotonic() + LIMIT_S
    error = ""
    while "your role may not read" not in error:  # a busy talker may publish nothing for a second
        assert time.monotonic() < deadline
        error = command("topic", "echo", "words", "--wait", "0.1").err

    assert "/rover/words" in error
    assert who in error


def test_topic_echo_of_a_silent_topic_times_out(command: Command) -> None:
    answer = command("topic", "echo", "velocity", "--wait", "0.1")
    silent = command("topic", "echo", "/rover/goal_pose", "--wait", "0.1")

    assert answer.code == 1
    assert "velocity" in answer.err
    assert ": /rover/" in answer.err
    assert "/rosout" not in answer.err
    assert silent.code == 1


def test_topic_hz_measures_the_rate(command: Command) -> None:
    def measure(seconds: str, *arguments: str) -> Answer:
        """Measure until the machine was not too busy for two messages."""
        while True:
            answer = command("topic", "hz", "words", "--seconds", seconds, *arguments)
            if answer.code == 0 and not re.search(r"messages\W+[01]\b", answer.out):
                return answer
            assert time.monotonic() < deadline, answer

    deadline = time.monotonic() + LIMIT_S
    result = measure("1", "--json").json

    assert result["topic"] == "/rover/words"
    assert result["messages"] >= 2
    assert result["hz"] > 0
    assert result["bytes"] == 52
    assert result["lost"] == 0
    assert "longest ms" in measure("0.5").out


def test_logs_prints_the_last_messages(command: Command) -> None:
    everything = command("logs").out
    one = command("logs", "listener", "--json").out.splitlines()

    assert "INFO    rover.root: child active: talker\n" in everything
    assert json.loads(one[0])["name"] == "rover.listener"
    # A warning of a slow start may come first.
    messages = [json.loads(line)["message"] for line in one]
    assert any(message.startswith("received 1, the last was ") for message in messages)


def test_logs_reports_a_component_that_does_not_answer(command: Command, rover: Run) -> None:
    kept = f"{keys.message_key(0, ROSOUT, Log)}/@adv/pub/hangs"
    unanswered: list[zenoh.Query] = []
    with (
        open_peer([rover.endpoint]) as session,
        session.declare_queryable(kept, unanswered.append),
        open_client([rover.endpoint]) as other,
        QueryableWatcher(other, kept) as watcher,
    ):
        assert watcher.wait(LIMIT_S)
        # One silent component does not delay the others' logs.
        printed = quick_answer(lambda: command("logs"), 4.0)
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
        printed = rover.await_line(r"received \d", after=len(rover.lines))
        now = count_in(rover.lines[printed - 1])
        for line in follower.stdout:
            if "received " in line and count_in(line) > now:
                break
        follower.send_signal(2)
        assert follower.wait(LIMIT_S) == 130
        errors = follower.stderr.read().splitlines()
        # On a busy computer, a component may not answer in time.
        assert [line for line in errors if "a component does not answer" not in line] == []


def count_in(line: str) -> int:
    """Return how many words the listener has received when it logged this line."""
    received = re.search(r"received (\d+),", line)
    assert received is not None, line
    return int(received[1])


def _fail(*_: object, **__: object) -> None:
    raise AssertionError("the graph is read")
