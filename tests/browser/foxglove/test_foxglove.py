"""Clients of the Foxglove protocol, by npm's client and decoder, with both of its subprotocols.

`foxglove-sdk` (PyPI, 0.30.3) has a server, but no client of its protocol `foxglove.sdk.v1`; its
messages are those of `foxglove.websocket.v1`, so the client of npm speaks it.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition
from cairn.console.browser import Browser
from cairn.console.hub import Hub
from cairn.console.operations import Arguments, ConsoleMethod
from cairn.console.source import Channel, ConnectionGraph, Message
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from tests.cairn.console.conftest import TOKEN, FakeSource, NoLease, Running, running

HERE = Path(__file__).parent
SENT_NS = 1_700_000_000_123_456_789
SCAN = LaserScan(
    header=Header(stamp=from_ns(SENT_NS), frame_id="laser"),
    angle_min=-1.5,
    angle_max=1.5,
    angle_increment=1.0,
    range_max=5.5,
    ranges=np.array([1.25, np.inf, 3.5, 0.125], np.float32),
)


class Sum(Arguments):
    robot: str
    a: int
    b: int


class FakeOperations(NoLease):
    """A component's parameters, and a method that is a service."""

    def __init__(self, hub: Hub) -> None:
        super().__init__(hub)
        self._hub_of_test = hub
        self._values: dict[str, Any] = {"particles": 500, "name": "a"}
        self.methods = {
            name: ConsoleMethod(self.methods[name].arguments, call)
            for name, call in (("parameters", self._read), ("set_parameters", self._write))
        } | {"add": ConsoleMethod(Sum, self._add, is_service=True)}

    async def _read(self, _: Browser, of: Any) -> Any:
        assert (of.robot, of.component) == ("robot", "localizer")
        return [{"name": name, "value": value} for name, value in self._values.items()]

    async def _write(self, _: Browser, to: Any) -> Any:
        self._values.update(to.values)
        self._hub_of_test.parameters_changed(to.robot, to.component, to.values)

    async def _add(self, _: Browser, numbers: Sum) -> Any:
        return numbers.a + numbers.b


class ScanningSource(FakeSource):
    """Publishes a scan as soon as a client subscribes."""

    async def run(self, hub: Hub) -> None:
        self._hub = hub
        status = Channel(2, "/robot/component_status", "cairn_msgs/msg/ComponentStatus", "")
        scan = Channel(1, "/robot/scan", "sensor_msgs/msg/LaserScan", definition(LaserScan))
        hub.set_graph(ConnectionGraph({"/robot/scan": frozenset({"/robot/laser"})}, {}))
        hub.set_link()
        hub.set_channels([scan, status])
        await asyncio.Event().wait()

    def subscribe(self, channel: Channel) -> None:
        super().subscribe(channel)
        self._hub.deliver(channel.id, Message(SENT_NS, Codec().encode(SCAN)))


@pytest.fixture(scope="session")
def modules(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install npm's client, in the versions of package-lock.json."""
    for program in ("node", "npm"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is missing: install the packages nodejs and npm")
    folder = tmp_path_factory.mktemp("npm")
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(HERE / name, folder)
    command = ["npm", "ci", "--no-audit", "--no-fund"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"npm cannot install the client of Foxglove: {done.stderr[-500:]}")
    return folder


@pytest.fixture
def console() -> Iterator[tuple[Running, ScanningSource]]:
    source = ScanningSource()
    with running(source, operations=FakeOperations) as console:
        yield console, source


@pytest.mark.parametrize("subprotocol", ["foxglove.websocket.v1", "foxglove.sdk.v1"])
def test_client_of_npm_uses_the_console(
    modules: Path, console: tuple[Running, ScanningSource], subprotocol: str
) -> None:
    running, source = console
    url = f"ws://127.0.0.1:{running.console.port}/?token={TOKEN}"

    done = subprocess.run(
        ["node", str(HERE / "client.mjs"), str(modules), url, subprotocol],
        capture_output=True,
        text=True,
        timeout=60,
    )

    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found["capabilities"]) == {
        "clientPublish", "parameters", "parametersSubscribe", "services", "connectionGraph",
    }  # fmt: skip
    assert found["subscribed"]
    assert found["timestamp"] == str(SENT_NS)
    assert found["scan"]["header"] == {
        "stamp": {"sec": SENT_NS // 10**9, "nanosec": SENT_NS % 10**9}, "frame_id": "laser",
    }  # fmt: skip
    assert found["scan"]["ranges"] == [1.25, None, 3.5, 0.125]  # JSON has no infinity
    assert found["scan"]["angle_increment"] == 1.0
    ((topic, type_name, payload),) = source.published
    assert (topic, type_name) == ("/robot/scan", "sensor_msgs/msg/LaserScan")
    assert Codec().decode(LaserScan, payload) == SCAN
    assert found["parameters"] == {
        "op": "parameterValues", "id": "first",
        "parameters": [{"name": "localizer.particles", "value": 500}],
    }  # fmt: skip
    assert found["changed"]["parameters"] == [{"name": "localizer.particles", "value": 700}]
    assert found["services"] == [["/robot/add", "json"]]
    assert found["sum"] == {"value": 5}
    assert "b" in found["failure"]
    assert found["graph"]["publishedTopics"] == [
        {"name": "/robot/scan", "publisherIds": ["/robot/laser"]}
    ]
    assert "no files" in found["asset"]
