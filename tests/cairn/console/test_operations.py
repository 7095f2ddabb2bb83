"""The methods and events of the console, with a simulated robot in real processes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import cairn.client
from cairn.client import Robot
from cairn.console.live import LiveSource
from cairn.schemas.cairn_nav_msgs import VelocityGateStatus
from cairn.schemas.geometry_msgs import Twist
from cairn.testing.launching import launching
from tests.cairn.bus.network import eventually
from tests.cairn.console.conftest import Page, Running, running
from tests.patience import LIMIT_S
from tests.wording import assert_words
from tests.zone_features import place

pytestmark = [pytest.mark.processes, pytest.mark.slow]

ROBOT = {"robot": "robot"}
STOPPED_WITHIN_S = 0.3


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with launching(tmp_path_factory.mktemp("console")) as launch:
        run = launch(Path("deploy/sim.yaml"), "--set", "stop_limit_s=100")
        run.await_line("child active: vision_supervisor")
        yield run.endpoint
        assert run.stop() == 0


@pytest.fixture
def live(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:
    monkeypatch.setattr("cairn.client.velocity_gate.CONFIRM_S", LIMIT_S)
    monkeypatch.setattr("cairn.console.operations._PROBE_S", LIMIT_S)
    with running(LiveSource(endpoint)) as console:
        assert eventually(lambda: bool(console.call(lambda: console.hub.robots)))
        yield console


@pytest.fixture
def robot(endpoint: str) -> Iterator[Robot]:
    with cairn.client.connect(endpoint) as robot:
        yield robot


def value(page: Page, method: str, **arguments: Any) -> Any:
    answer = page.call(method, **ROBOT, **arguments)
    assert "error" not in answer, answer
    return answer["value"]


def error(page: Page, method: str, **arguments: Any) -> str:
    answer = page.call(method, **ROBOT, **arguments)
    assert "error" in answer, answer
    return str(answer["error"])


def lease(page: Page, **expected: Any) -> None:
    """Wait for an event about the lease with these values."""
    while not expected.items() <= page.event("lease").items():
        pass


def test_one_of_two_pages_steers_and_hands_the_lease_over(live: Running) -> None:
    ada, bob = live.browser(), live.browser()
    lease(ada, holder="", mine=False)

    taken = value(ada, "acquire_lease", name="Ada")
    assert taken["mine"]
    assert taken["limits"]["speed"] == 0.6
    lease(bob, holder="Ada", mine=False)
    assert_words(error(bob, "go", poses=[[1.0, 1.0, 0.0]]), "Ada steers", "ask")
    assert_words(error(bob, "drive", speed=0.1), "Ada steers")
    value(bob, "ask_lease", name="Bob")
    lease(ada, asked_by="Bob")
    ada.close()

    lease(bob, holder="Bob", mine=True)
    bob.close()


def test_command_that_waited_until_the_lease_was_gone_is_not_sent(
    live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    busy, go_on, unloaded = threading.Semaphore(0), threading.Event(), []

    def restart(robot: Robot, component: str) -> None:
        busy.release()
        assert go_on.wait(LIMIT_S)

    monkeypatch.setattr(Robot, "restart", restart)
    monkeypatch.setattr(Robot, "unload", lambda _, component: unloaded.append(component))
    page = live.browser()
    value(page, "acquire_lease")
    of_base = {**ROBOT, "component": "base"}
    for number in range(100, 104):  # as many as a browser may have at the same time
        page.send(op="call", id=number, method="restart", arguments=of_base)
    assert all(busy.acquire(timeout=LIMIT_S) for _ in range(4))
    page.send(op="call", id=104, method="unload", arguments=of_base)
    value(page, "release_lease")
    go_on.set()

    assert_words(page.text("result", id=104)["error"], "take the lease first")
    assert unloaded == []
    page.close()


def test_goal_is_sent_and_canceled_and_the_map_explains_its_objects(live: Running) -> None:
    page = live.browser()
    assert_words(error(page, "cancel"), "lease", "acquire_lease")
    value(page, "acquire_lease")

    assert len(value(page, "go", poses=[[7.5, 5.0, 0.0]])["goal_id"]) == 32
    assert len(value(page, "cancel")["goal_id"]) == 32

    rows: dict[str, Any] = {}
    while (
        rows.get("map_builder", {}).get("state") != "active"
        or rows.get("base", {}).get("memory_bytes") is None
    ):
        rows = {one["name"]: one for one in page.event("components")["components"]}
    assert rows["base"]["memory_bytes"] > 1e6
    known = value(page, "why", object_id=1)
    assert known["object"]["object_id"] == 1
    assert known["steps"]
    assert_words(error(page, "why", object_id="nothing"), "no object nothing")
    rates = {one["topic"]: one for one in page.event("topics")}
    while not rates["/robot/odom"]["rate_hz"]:  # how much is up to the computer
        rates = {one["topic"]: one for one in page.event("topics")}
    assert rates["/robot/odom"]["age_s"] is not None
    page.close()


def test_zones_are_changed_with_the_lease_and_places_are_goals(live: Running) -> None:
    page = live.browser()
    kitchen = place("kitchen", 3.0, 1.2)
    add = {"verb": "add_zone", "arguments": {"feature": kitchen}}
    assert_words(error(page, "zones", **add), "lease")
    assert value(page, "zones", verb="zones")["features"] == []
    value(page, "acquire_lease")

    assert value(page, "zones", **add)["saved"]

    assert value(page, "zones", verb="zones")["features"] == [kitchen]
    assert_words(error(page, "zones", **add), "kitchen", "names must differ")
    assert_words(error(page, "zones", verb="drop_all"), "verb")
    assert len(value(page, "go", poses=["kitchen"])["goal_id"]) == 32
    assert_words(error(page, "go", poses=["cellar"]), "no such place", "kitchen")
    value(page, "cancel")
    value(page, "zones", verb="remove_zone", arguments={"name": "kitchen"})
    page.close()


def test_components_parameters_logs_and_the_world_are_reached(live: Running) -> None:
    page = live.browser()
    value(page, "acquire_lease")

    assert value(page, "restart", component="range_scanner") == "active"
    parameters = {one["name"]: one for one in value(page, "parameters", component="range_scanner")}
    assert parameters["rate"]["bounds"]
    refused = error(page, "set_parameters", component="velocity_gate", values={"speed": 9.0})
    assert_words(refused, "speed", "9.0")
    messages = [entry["msg"] for entry in value(page, "logs")]
    assert any("range_scanner" in one for one in messages)
    names = {row["name"] for row in value(page, "world", verb="list")}
    assert "robot" in names
    value(page, "world", verb="kidnap", arguments={"x": 2.0, "y": 1.0, "theta": 0.0})
    assert_words(error(page, "world", verb="move", arguments={"name": "x"}), "x")
    assert_words(error(page, "world", verb="drop"), "verb")
    page.close()


def test_only_the_lease_may_release_the_stop_that_every_page_may_engage(live: Running) -> None:
    page = live.browser()

    assert value(page, "stop", reason="a test")["emergency_stop"]
    assert_words(error(page, "release_stop"), "lease")
    value(page, "acquire_lease")
    assert not value(page, "release_stop")["emergency_stop"]
    page.close()


def seconds_to_stop(live: Running, robot: Robot, stop: Callable[[Page], object]) -> float:
    """Drive by hand, stop driving in a way, and return when the robot's command was zero [s]."""
    page = live.browser()
    while "error" in page.call("acquire_lease", **ROBOT):  # the page before is leaving
        pass
    commands: list[tuple[float, float]] = []
    with robot.subscribe(
        "cmd_vel", Twist, lambda twist: commands.append((time.monotonic(), twist.linear.x))
    ):
        stamp = None
        while not commands or commands[-1][1] < 0.15:
            stamp = value(page, "drive", speed=0.2, stamp=stamp)["stamp"]
        stopped_at = time.monotonic()
        stop(page)
        assert eventually(lambda: commands[-1][1] == 0.0)
    page.close()
    return next(at for at, speed in commands if at > stopped_at and speed == 0.0) - stopped_at


@pytest.mark.accuracy
@pytest.mark.realtime
def test_robot_that_is_driven_stops_when_the_page_is_gone(live: Running, robot: Robot) -> None:
    # Of three attempts: this process, or the robot's, may not run for a moment.
    assert any(
        seconds_to_stop(live, robot, lambda page: page.socket.socket.close()) < STOPPED_WITHIN_S
        for _ in range(3)
    )
    status = robot.latest("velocity_gate_status", VelocityGateStatus)
    assert status.source != "teleoperation"


@pytest.mark.accuracy
@pytest.mark.realtime
def test_robot_that_is_driven_stops_when_commands_cease(live: Running, robot: Robot) -> None:
    limit_s = 0.2 + STOPPED_WITHIN_S
    assert any(seconds_to_stop(live, robot, lambda _: None) < limit_s for _ in range(3))
