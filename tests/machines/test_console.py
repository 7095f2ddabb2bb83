"""The console of one machine shows and reaches the components of the others; a fallback works."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from cairn.console.live import LiveSource
from tests.cairn.bus.network import eventually
from tests.cairn.console.conftest import Page, running
from tests.machines.conftest import Machines
from tests.machines.test_two_machines import start, tree

pytestmark = [pytest.mark.processes, pytest.mark.xdist_group("machines")]


@pytest.mark.accuracy
def test_console_reaches_another_machine_and_shows_its_loss_while_the_fallback_works(
    machines: Machines,
) -> None:
    base, brain = start(machines, tree(machines, listener=", fallback: {}"))
    with running(LiveSource(base.endpoint)) as console:
        assert eventually(lambda: bool(console.call(lambda: console.hub.robots)))
        page = console.browser()

        def value(method: str, **arguments: Any) -> Any:
            answer = page.call(method, robot="robot", **arguments)
            assert "error" not in answer, answer
            return answer["value"]

        value("acquire_lease")
        before = brain.pid_of("listener")
        assert value("restart", component="listener") == "active"
        assert brain.pid_of("listener") != before
        value("set_parameters", component="listener", values={"log_level": "debug"})
        parameters = value("parameters", component="listener")
        assert {one["name"]: one["value"] for one in parameters}["log_level"] == "debug"
        assert eventually(lambda: "robot.listener" in {one["name"] for one in value("logs")})
        assert value("unload", component="reader")
        assert value("load", component="reader") == "active"
        both = {("base", "brain", "up"), ("brain", "base", "up")}
        await_machines(page, lambda rows: rows == both)

        machines.cable.is_cut = True
        base.await_line("child active: listener_fallback")
        states: dict[str, Any] = {}
        while states.get("listener") != "lost" or states.get("listener_fallback") != "active":
            rows = page.event("components")["components"]
            states = {one["name"]: one["state"] for one in rows}
        await_machines(page, lambda rows: rows == {("brain", "base", "lost")})
        base.await_line("listener_fallback: received")
        machines.cable.is_cut = False
        base.await_line("mobile: child stopped: listener_fallback")


def await_machines(page: Page, holds: Callable[[set[tuple[str, str, str]]], bool]) -> None:
    """Wait until what the console shows of each machine as another one sees it is as expected."""
    while True:
        rows = page.event("machines")["machines"]
        if holds({(one["machine"], one["seen_from"], one["state"]) for one in rows}):
            return
