"""Buses for the tests: real sessions on loopback or one in memory, and a reader that waits."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import psutil
import zenoh

from cairn import Qos
from cairn.bus.bus import Bus, Node
from cairn.bus.endpoints import socket_path
from cairn.bus.exclusive import Exclusive
from cairn.bus.graph import read_graph
from cairn.bus.keys import EndpointEntity, NodeEntity, tokens_pattern
from cairn.bus.session import open_client, open_peer, open_router
from cairn.bus.zenoh_bus import ZenohBus
from cairn.testing.launching import new_endpoint
from tests.patience import LIMIT_S

SECRET = "of the run"


def router_at(endpoint: str, *listen: str, secret: str = "") -> zenoh.Session:
    """Open a router at the endpoint of a Unix socket, and at more endpoints."""
    path = socket_path(endpoint)
    assert path is not None
    return open_router(path, listen, secret=secret)


class Network:
    """A router and the buses of any number of processes; `close` closes all."""

    def __init__(self, *listen: str) -> None:
        self._stack = ExitStack()
        self.endpoint = new_endpoint()
        self.router = ZenohBus(router_at(self.endpoint, *listen, secret=SECRET), secret=SECRET)
        self._stack.callback(self.router.close)

    def bus(self) -> ZenohBus:
        """Return the bus of one more process."""
        bus = ZenohBus(open_peer([self.endpoint], secret=SECRET), secret=SECRET)
        bus.graph.start()
        self._stack.callback(bus.close)
        return bus

    def graph(self, domain: int = 0) -> list[NodeEntity | EndpointEntity]:
        """Return the graph as a command sees it."""
        session = open_client([self.endpoint])
        try:
            return read_graph(session, tokens_pattern(domain), LIMIT_S)
        finally:
            session.close()

    def close(self) -> None:
        """Close all buses, then the router."""
        self._stack.close()


@contextmanager
def router_process() -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """A router in a process of its own, which a test may stop: its endpoint and the process."""
    endpoint = new_endpoint()
    program = [sys.executable, "-c", _ROUTER, str(socket_path(endpoint))]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as router:
        assert router.stdout is not None
        try:
            assert router.stdout.readline() == "ready\n"
            yield endpoint, router
        finally:
            router.kill()


_ROUTER = """
import signal, sys
from pathlib import Path
from cairn.bus import session

session.LEASE_MS = 3_600_000  # its links outlast any time for which it is stopped
router = session.open_router(Path(sys.argv[1]))
print("ready", flush=True)
signal.pause()
"""


def stop(process: "subprocess.Popen[str]") -> None:
    """Stop a process by SIGSTOP, and wait: until all are stopped, some of its threads may run."""
    process.send_signal(signal.SIGSTOP)
    assert eventually(lambda: psutil.Process(process.pid).status() == psutil.STATUS_STOPPED)


class Reader:
    """A subscription whose messages can be waited for."""

    def __init__(
        self,
        node: Node,
        topic: str,
        message: type[Any],
        qos: Qos,
        exclusive: Exclusive | None = None,
    ) -> None:
        self._waiting = threading.Semaphore(0)
        self.subscription = node.subscribe(topic, message, qos, self._waiting.release, exclusive)

    def next(self) -> Any:
        """Return the next message."""
        assert self._waiting.acquire(timeout=LIMIT_S), "nothing came"
        return self.subscription.take()

    def next_of(self, count: int) -> list[Any]:
        """Return that many messages."""
        return [self.next() for _ in range(count)]

    def await_first(self) -> None:
        """Wait until a message is pending, without taking it."""
        assert self._waiting.acquire(timeout=LIMIT_S), "nothing came"
        self._waiting.release()

    def pending(self) -> list[Any]:
        """Return all pending messages."""
        return list(iter(self.subscription.take, None))


def node(bus: Bus, name: str) -> Node:
    """Return a node whose error reports fail the test."""
    return bus.node(name, fail_test)


def fail_test(problem: str) -> None:
    """Fail the test: no error is expected."""
    raise AssertionError(problem)


def eventually(holds: Callable[[], bool]) -> bool:
    """Whether it holds within the limit."""
    deadline = time.monotonic() + LIMIT_S
    pause = threading.Event()
    while not holds():
        if time.monotonic() > deadline:
            return False
        pause.wait(0.002)
    return True
