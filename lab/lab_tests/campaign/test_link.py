"""A link passes on bytes as its conditions say, and loses none."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from cairn.errors import CairnError
from cairn.testing.launching import free_port
from cairn_lab.campaign.link import HOST, Link, LinkConditions

DATA = bytes(range(256)) * 200


class Cabled:
    """A connection through a link to a server that sends back what it receives."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.client = socket.create_connection((HOST, link.port), timeout=20)

    def exchange(self, data: bytes) -> float:
        """Send data and receive it again; return how long that took [s]."""
        began = time.monotonic()
        self.client.sendall(data)
        self.receive(data)
        return time.monotonic() - began

    def receive(self, data: bytes) -> None:
        """Receive data."""
        received = b""
        while len(received) < len(data):
            received += self.client.recv(65536)
        assert received == data


def echo(listener: socket.socket) -> None:
    connection, _ = listener.accept()
    with closing(connection):
        while data := connection.recv(65536):
            connection.sendall(data)


@pytest.fixture
def cabled() -> Iterator[Cabled]:
    with closing(socket.create_server((HOST, 0))) as listener:
        threading.Thread(target=echo, args=(listener,), daemon=True).start()
        link = Link("base-brain", free_port(), listener.getsockname()[1])
        made = Cabled(link)
        yield made
        link.close()
        assert made.client.recv(1) == b"", "closed with its link"
        made.client.close()


def test_cut_link_passes_nothing_until_it_is_restored(cabled: Cabled) -> None:
    cabled.exchange(DATA)
    with cabled.link.disturbed(LinkConditions(is_cut=True)):
        with cabled.link.disturbed(LinkConditions(latency_s=0.01)):
            cabled.client.sendall(DATA)
        cabled.client.settimeout(0.2)
        with pytest.raises(TimeoutError):
            cabled.client.recv(1)
        cabled.client.settimeout(20)
    cabled.receive(DATA)


@pytest.mark.parametrize(
    ("conditions", "shortest_s"),
    [
        (LinkConditions(latency_s=0.1), 0.2),
        (LinkConditions(latency_s=0.05, jitter_s=0.05), 0.1),
        (LinkConditions(loss=0.99), 0.2),
        (LinkConditions(bandwidth=200_000.0), len(DATA) / 200_000),
    ],
    ids=["latency", "jitter", "loss", "bandwidth"],
)
def test_slow_link_delivers_everything_in_order(
    cabled: Cabled, conditions: LinkConditions, shortest_s: float
) -> None:
    with cabled.link.disturbed(conditions, seed=3):
        assert cabled.exchange(DATA) > shortest_s * 0.9


def test_link_to_a_machine_that_does_not_run_closes_the_connection() -> None:
    link = Link("base-brain", free_port(), free_port())
    with socket.create_connection((HOST, link.port), timeout=20) as client:
        assert client.recv(1) == b""
    link.close()


def test_port_in_use_is_reported() -> None:
    with (
        closing(socket.create_server((HOST, 0))) as taken,
        pytest.raises(CairnError, match=r"link base-brain: port .* cannot be opened: "),
    ):
        Link("base-brain", taken.getsockname()[1], 1)
