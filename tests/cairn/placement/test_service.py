"""A service manager is told when a deployment is ready, lives, and stops."""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from cairn.placement.service import service_manager
from cairn.testing.launching import LIMIT_S, Launching

pytestmark = pytest.mark.processes


class Manager:
    """A service manager that a deployment reports to."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.address)
        self.socket.settimeout(LIMIT_S)

    def hear(self, wanted: str) -> list[str]:
        """Wait for a message; returns what else came before it."""
        before = []
        while not (message := self.socket.recv(4096).decode()).startswith(wanted):
            before.append(message)
        return before


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    """One that listens."""
    manager = Manager(tmp_path)
    yield manager
    manager.socket.close()


def test_it_is_told_of_start_life_and_stop(launch: Launching, manager: Manager) -> None:
    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "600000"}
    run = launch("components: {talker: {plugin: test_talker}}", environment=environment)

    manager.hear("READY=1")
    assert run.lines, "it says it is ready before it has said anything"
    assert manager.hear("WATCHDOG=1") == []
    run.process.send_signal(signal.SIGTERM)
    manager.hear("STOPPING=1")
    run.await_end()


def test_a_root_that_hangs_does_not_feed_the_watchdog(manager: Manager) -> None:
    service = service_manager({"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "3000"})

    service.tell(active=True, sound=False)
    service.tell(active=False, sound=True)

    assert manager.hear("STOPPING=1") == ["READY=1\nSTATUS=active"]


def test_the_watchdog_is_not_started_before_all_is_active(manager: Manager) -> None:
    service = service_manager({"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "3000"})

    service.tell(active=False, sound=True)
    service.tell(active=True, sound=True)

    assert manager.hear("READY=1") == []
    assert manager.hear("WATCHDOG=1") == []


def test_what_is_for_this_process_is_not_handed_on(manager: Manager) -> None:
    environment = {
        "NOTIFY_SOCKET": manager.address,
        "WATCHDOG_USEC": "3000",
        "WATCHDOG_PID": str(os.getpid() + 1),
        "PATH": "/bin",
    }

    service = service_manager(environment)
    service.tell(active=True, sound=True)
    service.tell(active=False, sound=True)

    assert environment == {"PATH": "/bin"}
    assert manager.hear("STOPPING=1") == ["READY=1\nSTATUS=active"]  # no watchdog: another's
