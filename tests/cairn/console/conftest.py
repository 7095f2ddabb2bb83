"""A console in this process, on a thread with its event loop, with a source that the test moves."""

from __future__ import annotations

import asyncio
import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, TypeVar

import pytest
from websockets.sync.client import ClientConnection, connect

from cairn.client.connection import Connection
from cairn.console.browser import Browser
from cairn.console.hub import Hub
from cairn.console.operations import ConsoleOperations, Operations
from cairn.console.protocol import CONSOLE
from cairn.console.server import Address, Console
from cairn.console.source import Channel, Message, Source
from cairn.errors import CairnError
from tests.patience import LIMIT_S

T = TypeVar("T")

TOKEN = "token-of-the-tests"


class FakeSource:
    """Channels and messages that a test gives; what is published is kept."""

    mode: Literal["live", "recording"] = "live"
    recording = None

    def __init__(self) -> None:
        self.subscribed: list[str] = []
        self.last: dict[int, list[Message]] = {}
        self.published: list[tuple[str, str, bytes]] = []

    @property
    def connection(self) -> Connection:
        raise CairnError("no connection")

    async def run(self, hub: Hub) -> None:
        hub.set_link()
        await asyncio.Event().wait()

    def subscribe(self, channel: Channel) -> None:
        self.subscribed.append(channel.topic)

    def unsubscribe(self, channel: Channel) -> None:
        self.subscribed.remove(channel.topic)

    def kept(self, channel: Channel) -> Sequence[Message]:
        return self.last.get(channel.id, [])

    async def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        self.published.append((topic, type_name, payload))


class NoLease(Operations):
    """Lets every browser publish."""

    def refusal(self, browser: Browser, robot: str) -> str:
        del browser, robot
        return ""


class Running:
    """A console that runs; `call` does something on its event loop."""

    def __init__(
        self,
        source: Source,
        may: Literal["watch", "steer"],
        address: Address,
        operations: Callable[[Hub], ConsoleOperations],
    ) -> None:
        self.hub: Hub
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(source, may, address, operations))
        self._thread.start()
        assert self._ready.wait(LIMIT_S)

    def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Call a function on the event loop and return its result."""

        async def called() -> T:
            return function(*arguments)

        return asyncio.run_coroutine_threadsafe(called(), self._loop).result(LIMIT_S)

    def browser(self, subprotocol: str = CONSOLE, token: str = TOKEN, **options: Any) -> Page:
        """Connect as a browser does."""
        protocols: Any = [subprotocol]
        url = f"ws://127.0.0.1:{self.console.port}/ws?token={token}"
        return Page(connect(url, subprotocols=protocols, max_size=None, legacy=True, **options))

    def close(self) -> None:
        self.call(self.console.stop)
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()

    def _run(
        self,
        source: Source,
        may: Literal["watch", "steer"],
        address: Address,
        operations: Callable[[Hub], ConsoleOperations],
    ) -> None:
        async def run() -> None:
            self._loop = asyncio.get_running_loop()
            self.hub = Hub(source, may, operations)
            self.console = Console(self.hub, address, TOKEN)
            running = asyncio.create_task(self.console.run())
            while not self.console.is_serving:
                await asyncio.sleep(0)
            self._ready.set()
            await running

        asyncio.run(run())


class Page:
    """A WebSocket client that sorts what it receives."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self._texts: list[dict[str, Any]] = []
        self._frames: deque[bytes] = deque()

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def text(self, op: str, **fields: Any) -> dict[str, Any]:
        """Return the next message with this `op` and fields; others stay."""
        read = 0
        while True:
            while read == len(self._texts):
                self._receive()
            message = self._texts[read]
            if message["op"] == op and fields.items() <= message.items():
                del self._texts[read]
                return message
            read += 1

    def event(self, name: str) -> Any:
        return self.text("event", name=name)["value"]

    def data(self) -> tuple[int, int, bytes]:
        """Return subscription, time and payload of the next message of a topic."""
        while not self._frames:
            self._receive()
        frame = self._frames.popleft()
        assert frame[0] == 1
        return (
            int.from_bytes(frame[1:5], "little"),
            int.from_bytes(frame[5:13], "little"),
            frame[13:],
        )

    def call(self, method: str, **arguments: Any) -> dict[str, Any]:
        self.send(op="call", id=7, method=method, arguments=arguments)
        return self.text("result", id=7)

    def close(self) -> None:
        self.socket.close()

    def _receive(self) -> None:
        frame = self.socket.recv(LIMIT_S)
        if isinstance(frame, str):
            self._texts.append(json.loads(frame))
        else:
            self._frames.append(frame)


@contextmanager
def running(
    source: Source,
    may: Literal["watch", "steer"] = "steer",
    address: Address = Address(),  # noqa: B008 - it is frozen
    operations: Callable[[Hub], ConsoleOperations] = Operations,
) -> Iterator[Running]:
    """Run a console on a port of its own."""
    console = Running(source, may, address, operations)
    try:
        yield console
    finally:
        console.close()


@pytest.fixture
def source() -> FakeSource:
    return FakeSource()


@pytest.fixture
def console(source: FakeSource) -> Iterator[Running]:
    with running(source) as console:
        yield console


@pytest.fixture(scope="module")
def idle_console() -> Iterator[Running]:
    """A console without topics, for all tests of a module."""
    with running(FakeSource()) as console:
        yield console
