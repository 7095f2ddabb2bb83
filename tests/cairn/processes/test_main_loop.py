"""The main loop of a process that stops ends in time, whatever its component does."""

import signal
import threading
from typing import cast

import pytest

from cairn.processes import component_process
from cairn.processes.component_process import ComponentHost, MainLoop


class HangingHost:
    """A host whose component never ends."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self.stops = 0
        self.stop_overdue = False

    def expect_stop(self) -> None:
        self.stops += 1
        self.stop_overdue = True

    def terminate(self) -> None:
        """Do nothing: the component hangs."""

    def publish_heartbeats(self) -> None:
        """Do nothing: nothing listens."""


def test_component_that_hangs_ends_the_loop_at_the_stop_limit() -> None:
    host = HangingHost()
    loop = MainLoop(cast("ComponentHost", host))
    with loop.stop_signals(signal.SIGUSR2):
        signal.raise_signal(signal.SIGUSR2)

        assert not loop.run(force=True)
    assert host.stops == 1


def test_stop_without_a_signal_ends_the_loop_at_its_limit() -> None:
    host = HangingHost()
    loop = MainLoop(cast("ComponentHost", host))

    def escalate() -> None:
        host.stop_overdue = True

    assert not loop.run(escalate, force=True)
    assert host.stops == 0


def test_loop_returns_free_memory_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    host = HangingHost()
    returned = 0

    def count() -> None:
        nonlocal returned
        returned += 1
        if returned == 3:
            host.ended.set()

    monkeypatch.setattr(component_process, "_FREE_MEMORY_S", 0.0)
    monkeypatch.setattr(component_process, "return_free_memory", count)

    assert MainLoop(cast("ComponentHost", host)).run()
    assert returned == 3
