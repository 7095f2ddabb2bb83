"""systemd is notified when a deployment is ready, runs, and stops."""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from cairn.placement.systemd_notify import service_manager
from cairn.testing.launching import LIMIT_S, Launching

pytestmark = pytest.mark.processes


class Manager:
    """A service manager that a deployment reports to."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.address)
        self.socket.settimeout(LIMIT_S)

    def receive_until(self, expected: str) -> list[str]:
        """Wait for a message; return the messages before it."""
        before = []
        while not (message := self.socket.recv(4096).decode()).startswith(expected):
            before.append(message)
        return before


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    """A service manager that listens."""
    manager = Manager(tmp_path)
    yield manager
    manager.socket.close()


def test_start_progress_and_stop_are_notified(launch: Launching, manager: Manager) -> None:
    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "600000"}
    run = launch("components: {talker: {plugin: test_talker}}", environment=environment)

    manager.receive_until("READY=1")
    assert run.lines, "it reports READY=1 before it has written anything"
    assert manager.receive_until("WATCHDOG=1") == []
    run.process.send_signal(signal.SIGTERM)
    manager.receive_until("STOPPING=1")
    run.await_end()


def test_root_that_hangs_sends_no_watchdog_messages(manager: Manager) -> None:
    service = service_manager({"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "3000"})

    service.notify(active=True, healthy=False)
    service.notify(active=False, healthy=True)

    assert manager.receive_until("STOPPING=1") == ["READY=1\nSTATUS=active"]


def test_watchdog_does_not_start_before_all_components_are_active(manager: Manager) -> None:
    service = service_manager({"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "3000"})

    service.notify(active=False, healthy=True)
    service.notify(active=True, healthy=True)

    assert manager.receive_until("READY=1") == []
    assert manager.receive_until("WATCHDOG=1") == []


def test_variables_of_the_service_manager_are_not_inherited(manager: Manager) -> None:
    environment = {
        "NOTIFY_SOCKET": manager.address,
        "WATCHDOG_USEC": "3000",
        "WATCHDOG_PID": str(os.getpid() + 1),
        "PATH": "/bin",
    }

    service = service_manager(environment)
    service.notify(active=True, healthy=True)
    service.notify(active=False, healthy=True)

    assert environment == {"PATH": "/bin"}
    assert manager.receive_until("STOPPING=1") == ["READY=1\nSTATUS=active"]
