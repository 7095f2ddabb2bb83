"""What the console shows of components and topics."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

from cairn import SECOND, from_ns
from cairn.bus.codec import Codec
from cairn.console.monitoring import ProcessLoad, ProcessMonitor, StatusMonitor
from cairn.console.source import Channel, ConnectionGraph, Message
from cairn.schemas.cairn_msgs import ComponentStatus, MachineLink, MachineStatus, PortStatus
from cairn.schemas.std_msgs import Header

STATUS_TOPIC = "/robot/component_status"
EMPTY = ConnectionGraph({}, {})
SUPERVISOR = ComponentStatus(
    header=Header(), component="boss", state="active", pid=7, children=("base", "localizer")
)
BASE = ComponentStatus(
    header=Header(), component="base", parent="boss", state="active", pid=8,
    ports=(
        PortStatus(port="odom", topic="/robot/odom", direction=PortStatus.OUT),
        PortStatus(port="cmd_vel", topic="/robot/cmd_vel", direction=PortStatus.IN, dropped=2),
    ),
)  # fmt: skip


def graph_of(*names: str) -> ConnectionGraph:
    return ConnectionGraph({STATUS_TOPIC: frozenset(f"/robot/{one}" for one in names)}, {})


class Bench:
    """A monitor whose messages arrive at their time of sending."""

    def __init__(self) -> None:
        self.monitor = StatusMonitor(lambda message: message.time_ns)

    def receive(self, status: ComponentStatus, at_s: float) -> None:
        at = round(at_s * SECOND)
        sent = replace(status, header=Header(stamp=from_ns(at)))
        self.monitor.receive("robot", Message(at, Codec().encode(sent)))
        self.monitor.update()

    def rows(self, graph: ConnectionGraph, at_s: float) -> dict[str, Any]:
        loads = {8: ProcessLoad(12.5, 1000)}
        rows = self.monitor.components("robot", graph, loads, round(at_s * SECOND))
        return {row["name"]: row for row in rows}


def test_components_are_listed_with_those_that_are_not_loaded_or_do_not_answer() -> None:
    bench = Bench()
    bench.receive(SUPERVISOR, 1.0)
    bench.receive(BASE, 1.0)

    everything = graph_of("boss", "base", "silent")
    assert bench.rows(everything, 1.0).keys() == {"boss", "base", "localizer"}
    bench.receive(SUPERVISOR, 4.1)
    bench.receive(BASE, 4.1)
    rows = bench.rows(everything, 4.1)
    assert {name: row["state"] for name, row in rows.items()} == {
        "boss": "active", "base": "active", "localizer": "not loaded", "silent": "no answer",
    }  # fmt: skip
    assert (rows["base"]["cpu_percent"], rows["base"]["memory_bytes"]) == (12.5, 1000)
    assert (rows["base"]["drops"], rows["base"]["parent"]) == (2, "boss")
    assert rows["localizer"]["parent"] == "boss"

    bench.monitor.receive("robot", Message(4 * SECOND, Codec().encode(BASE)))  # not decoded yet
    assert bench.rows(graph_of("boss", "base"), 4.2)["base"]["state"] == "active"
    bench.monitor.update()
    bench.receive(SUPERVISOR, 9.0)
    states = {
        name: bench.rows(graph_of("boss", name), 9.1).get("base", {}).get("state")
        for name in ("base", "other")
    }
    assert states == {"base": "no answer", "other": "not loaded"}


def test_siblings_are_in_the_order_of_the_deployment_whichever_reports_first() -> None:
    bench = Bench()
    localizer = ComponentStatus(
        header=Header(), component="localizer", parent="boss", state="active", pid=9
    )
    for one in (localizer, replace(SUPERVISOR, children=("absent", "base", "localizer")), BASE):
        bench.receive(one, 1.0)

    rows = bench.rows(graph_of("boss", "base", "localizer"), 1.0)

    assert list(rows) == ["boss", "absent", "base", "localizer"]


def test_components_of_a_lost_machine_are_lost_and_never_measured_here() -> None:
    bench = Bench()
    root = replace(SUPERVISOR, component="root", machine="one", pid=1, children=("base", "seer"))
    base = replace(BASE, parent="root", machine="one")
    far = replace(root, component="root_two", machine="two", pid=2, children=("seer",))
    seer = replace(base, component="seer", machine="two")  # whose pid is that of base
    unseen = ("seer", "reader")

    def receive_machine(link: MachineLink, at_s: float) -> None:
        at = round(at_s * SECOND)
        status = MachineStatus(Header(stamp=from_ns(at)), "one", links=(link,))
        bench.monitor.receive_machine("robot", Message(at, Codec().encode(status)))

    receive_machine(MachineLink("two", is_up=True, silent_s=0.1), 1.0)
    for one in (seer, far, base, root):
        bench.receive(one, 1.0)
    bench.monitor.update(router=1)
    rows = bench.rows(graph_of("root", "base", "root_two", "seer"), 1.0)
    assert (rows["base"]["cpu_percent"], rows["seer"]["cpu_percent"]) == (12.5, None)
    assert (rows["seer"]["machine"], rows["seer"]["parent"]) == ("two", "root")
    assert bench.monitor.pids() == [1, 8]

    receive_machine(MachineLink("two", silent_s=2.0, components=unseen, inputs=("/a (seer)",)), 3.0)
    for one in (base, root):
        bench.receive(one, 3.0)
    rows = bench.rows(graph_of("root", "base"), 3.0)
    assert {name: (row["machine"], row["state"]) for name, row in rows.items()} == {
        "root_two": ("two", "active"), "root": ("one", "active"), "base": ("one", "active"),
        "seer": ("two", "lost"), "reader": ("two", "lost"),
    }  # fmt: skip
    (link,) = bench.monitor.machines("robot", 3 * SECOND)
    assert (link["machine"], link["seen_from"], link["state"]) == ("two", "one", "lost")
    assert (link["silent_s"], link["clock_offset_ms"], link["missing"]) == (
        2.0,
        None,
        ["/a (seer)"],
    )
    assert bench.monitor.machines("robot", 10 * SECOND) == []  # it is silent itself


def test_rates_and_ages_follow_from_the_counters_also_after_a_restart() -> None:
    bench = Bench()
    channels = [Channel(1, "/robot/odom", "nav_msgs/msg/Odometry", "")]

    def row(messages: int, at_s: float) -> dict[str, Any]:
        odom = replace(BASE.ports[0], messages=messages)
        bench.receive(replace(BASE, ports=(odom,)), at_s)
        (found,) = bench.monitor.topics(channels, EMPTY)
        return found

    assert (row(100, 1.0)["rate_hz"], row(100, 1.0)["age_s"]) == (None, None)
    assert row(150, 2.0)["rate_hz"] == 50.0
    assert row(10, 3.0)["rate_hz"] == 10.0
    later = row(10, 5.0)
    assert (later["rate_hz"], later["age_s"], later["type"]) == (0, 2.0, "nav_msgs/msg/Odometry")


def test_foreign_nodes_of_a_topic_are_named() -> None:
    nodes = {"/odom": frozenset({"/ros/base", "/robot/localizer"})}
    graph = ConnectionGraph(nodes, nodes, frozenset({"/ros/base", "/ros/rviz"}))

    (found,) = Bench().monitor.topics([], graph)

    assert (found["publishers"], found["subscribers"]) == (2, 2)
    assert found["foreign_publishers"] == found["foreign_subscribers"] == ["/ros/base"]


def test_status_that_is_not_valid_is_ignored() -> None:
    monitor = StatusMonitor(lambda _: 0)
    for payload in (b"", bytes(40), b"\0\1\0\0" + b"\xff" * 40, Codec().encode(BASE)[:60]):
        monitor.receive("robot", Message(0, payload))

    monitor.update()

    assert monitor.components("robot", EMPTY, {}, 0) == []


def test_only_processes_of_cairn_on_this_computer_are_measured() -> None:
    assert ProcessMonitor().loads([1, 2**22 + 1, os.getppid()]) == {}
