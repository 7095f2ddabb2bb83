"""The display of `cairn up` shows what its process has published before it ends."""

import threading
import time

import pytest

from cairn import LATCHED
from cairn.bus.lockstep_bus import LockstepBus
from cairn.cli.up_messages import LogWatch, Watch
from cairn.deployment.model import ROOT
from cairn.runtime.rosout import ROSOUT, ROSOUT_QOS
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header
from tests.cairn.bus.network import Network, node
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


class RecordingView:
    """Keeps what it is to display."""

    def __init__(self) -> None:
        self.states: list[str] = []
        self.messages: list[str] = []

    def log(self, entry: Log) -> None:
        self.messages.append(entry.msg)

    def status(self, status: ComponentStatus) -> None:
        self.states.append(status.state)

    def time(self, now: int) -> None:
        """Do nothing."""

    def refresh(self) -> None:
        """Do nothing: everything is kept at once."""


def test_last_message_and_last_status_of_the_root_are_displayed_however_late(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cairn.cli.up_messages._FINISH_LIMIT_S", LIMIT_S)
    network = Network()
    root = node(network.router, f"/rover/{ROOT}")
    log = root.advertise(ROSOUT, Log, ROSOUT_QOS)
    status = root.advertise("/rover/component_status", ComponentStatus, LATCHED)
    view = RecordingView()
    watch = LogWatch(network.router, "rover", view, clock=False, hurry=lambda: None)
    log.publish(Log(name=f"rover.{ROOT}", msg="child stopped"))
    last = ComponentStatus(header=Header(), component=ROOT, state="finalized")
    late = threading.Timer(0.3, status.publish, [last])
    late.start()

    watch.finish()

    late.join()
    network.close()
    assert view.messages == ["child stopped"]
    assert view.states == ["finalized"]


def test_flood_of_log_records_is_displayed_in_part_and_counted() -> None:
    network = Network()
    peer = node(network.router, "/rover/forged")
    log = peer.advertise(ROSOUT, Log, ROSOUT_QOS)
    view = RecordingView()
    watch = LogWatch(network.router, "rover", view, clock=False, hurry=lambda: None)
    sent = 0
    deadline = time.monotonic() + LIMIT_S
    while not any("suppressed" in message for message in view.messages):
        for _ in range(500):  # its queue has 1000
            log.publish(Log(name="rover.base", msg="x" * 20_000))
        sent += 500
        watch.refresh()
        assert time.monotonic() < deadline

    network.close()
    assert len(view.messages) < sent
    assert max(map(len, view.messages)) < 11_000


def test_refresh_ends_while_a_program_publishes_faster_than_it_reads() -> None:
    bus = LockstepBus()
    peer = bus.node("/rover/forged", lambda _: None)
    status = peer.advertise("/rover/component_status", ComponentStatus, LATCHED)
    forged = ComponentStatus(header=Header(), component="forged")

    class EndlessView(RecordingView):
        def status(self, status_: ComponentStatus) -> None:
            super().status(status_)
            status.publish(forged)  # one more, however many are read

    view = EndlessView()
    watch = Watch(bus, "rover", view, clock=False)
    status.publish(forged)

    watch.refresh()

    assert view.states
