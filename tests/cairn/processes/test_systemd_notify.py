"""systemd is notified when a deployment is ready, runs, and stops."""

import os
import signal
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from cairn.processes.systemd_notify import service_manager
from cairn.testing.launching import LIMIT_S, Launching
from tests.wording import assert_words

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

    def fill(self) -> None:
        """Send messages until the socket takes no more, as if the manager did not read."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            with suppress(BlockingIOError):
                while True:
                    sender.sendto(b"filler", self.address)

    def empty(self) -> None:
        """Read all messages that are pending."""
        self.socket.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                self.socket.recv(4096)
        self.socket.settimeout(LIMIT_S)


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    """A service manager that listens."""
    manager = Manager(tmp_path)
    yield manager
    manager.socket.close()


def test_start_progress_and_stop_are_notified(launch: Launching, manager: Manager) -> None:
    # One watchdog message is due: more of them might fill the socket before the test reads on.
    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "600000000"}
    run = launch("components: {talker: {plugin: test_talker}}", environment=environment)

    manager.receive_until("READY=1")
    assert "child active: talker" in run.log_of("root"), "it reports READY=1 before it is active"
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


def test_messages_to_a_busy_manager_are_sent_later(manager: Manager) -> None:
    service = service_manager({"NOTIFY_SOCKET": manager.address})

    for active, message in ((True, "READY=1"), (False, "STOPPING=1")):
        manager.fill()
        service.notify(active=active, healthy=True)
        manager.empty()
        service.notify(active=active, healthy=True)
        service.notify(active=active, healthy=True)

        assert manager.receive_until(message) == []
    manager.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        manager.socket.recv(4096)


def test_manager_that_rejects_messages_is_logged_once_and_does_not_end_the_robot(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stream = socket.socket(socket.AF_UNIX)  # accepts connections, but no messages
    stream.bind(str(tmp_path / "notify"))
    service = service_manager({"NOTIFY_SOCKET": str(tmp_path / "notify")})

    for _ in range(2):
        service.notify(active=True, healthy=True)

    stream.close()
    [message] = caplog.messages
    assert_words(message, "service manager not notified", str(tmp_path), "NOTIFY_SOCKET")


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
