"""A component hosted on a thread of this process, asked and ended as its supervisor does."""

from collections.abc import Iterator

import pytest

from cairn import CairnError, Component, every
from cairn.bus.session import open_router
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.model import ChildSpec
from cairn.placement.hosted import Hosted
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.testing.launching import LIMIT_S, free_port

pytestmark = pytest.mark.processes


class Mute(Component):
    """Stands still."""


class Brief(Component):
    """Finishes at its first tick."""

    @every(hz=100)
    def tick(self) -> None:
        self.finish("that was all")


class Broken(Component):
    """Cannot be configured."""

    def on_configure(self) -> None:
        raise ValueError("no device")


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def bus(endpoint: str) -> Iterator[ZenohBus]:
    bus = ZenohBus(open_router(endpoint))
    yield bus
    bus.close()


def hosted(bus: ZenohBus, endpoint: str, component: type[Component]) -> Hosted:
    host = Hosted(
        LaunchRequest(
            name="thing",
            spec=ChildSpec(plugin=f"{__name__}:{component.__name__}"),
            parent="root",
            context=RunContext(endpoints=(endpoint,)),
        ),
        bus,
    )
    host.start()
    return host


def test_it_walks_its_life_cycle_on_request(bus: ZenohBus, endpoint: str) -> None:
    host = hosted(bus, endpoint, Mute)

    answers = [host.request(verb, LIMIT_S) for verb in ("configure", "activate", "shutdown")]

    assert answers == ["inactive", "active", "finalized"]
    assert host.ended.wait(LIMIT_S)
    assert host.end is not None
    assert (host.end.normal, host.end.reason) == (True, "shut down")
    host.close()


def test_it_tells_its_own_normal_end(bus: ZenohBus, endpoint: str) -> None:
    host = hosted(bus, endpoint, Brief)
    host.request("configure", LIMIT_S)
    host.request("activate", LIMIT_S)

    assert host.ended.wait(LIMIT_S)

    assert host.end is not None
    assert (host.end.normal, host.end.reason) == (True, "that was all")
    host.close()


def test_a_transition_that_fails_is_an_error_and_its_end(bus: ZenohBus, endpoint: str) -> None:
    host = hosted(bus, endpoint, Broken)

    with pytest.raises(CairnError, match="configure failed: ValueError: no device"):
        host.request("configure", LIMIT_S)

    assert host.ended.wait(LIMIT_S)
    assert host.end is not None
    assert (host.end.normal, host.end.reason) == (False, "on_configure: ValueError: no device")
    host.close()


def test_a_loop_that_dies_is_an_abnormal_end_and_no_silence(
    bus: ZenohBus, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = hosted(bus, endpoint, Mute)

    def defect(*_: object) -> None:
        raise KeyError("a defect of ours")

    monkeypatch.setattr(host.runtime, "request", defect)
    host.ask("configure")

    assert host.ended.wait(LIMIT_S)
    assert host.end is not None
    assert not host.end.normal
    assert host.end.reason == "its loop failed: KeyError: 'a defect of ours'"
    host.close()
