"""A link between two machines that run on one computer: a TCP relay whose conditions may be set.

The routers of the machines speak TLS through it, as over a network. It passes on bytes, not
packets. TCP sends again what a network loses, so a loss is a stall of all that follows.
"""

from __future__ import annotations

import asyncio
import math
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from random import Random
from typing import TypeAlias

from cairn.errors import CairnError

HOST = "127.0.0.1"
"""The address of all machines and links."""

_CHUNK = 16 << 10  # bytes: a record of TLS
_MOST_CHUNKS = 64  # under way in one direction; then the sender waits, as for TCP's window
_RETRANSMISSION_S = 0.2  # Linux sends a lost packet again after this time at the earliest

_Streams: TypeAlias = tuple[asyncio.StreamReader, asyncio.StreamWriter]
_Queue: TypeAlias = "asyncio.Queue[tuple[float, bytes]]"


@dataclass(frozen=True)
class LinkConditions:
    """What a link does to the bytes that it passes on, in each direction.

    Attributes:
        is_cut: nothing is passed on.
        latency_s: time under way [s].
        jitter_s: largest addition to that [s], drawn for each piece; the order is kept.
        loss: share of the pieces that are sent again, and stall all that follow [1].
        bandwidth: limit [bytes/s].
    """

    is_cut: bool = False
    latency_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    bandwidth: float = math.inf


class Link:
    """Passes on what is sent to `port` to port `to` of this computer, and back."""

    def __init__(self, name: str, port: int, to: int) -> None:
        """Listen, on a thread of its own. Raises `CairnError` if that is impossible."""
        self.name = name
        self.port = port
        self._to = to
        self._added: list[LinkConditions] = []
        self._conditions = LinkConditions()  # all those together
        self._random = Random(0)
        self._connections: set[asyncio.Task[None]] = set()
        self._passes = asyncio.Event()
        self._passes.set()
        self._is_closed = asyncio.Event()
        try:
            self._listener = socket.create_server((HOST, port))
        except OSError as error:
            raise CairnError(f"link {name}: port {port} cannot be opened: {error}") from error
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name=f"link {name}", daemon=True)
        self._thread.start()

    @contextmanager
    def disturbed(self, conditions: LinkConditions, seed: int = 0) -> Iterator[None]:
        """Add conditions while the context lasts; jitter and losses are drawn by the seed."""
        self._added.append(conditions)
        self._loop.call_soon_threadsafe(self._combine, Random(seed))
        try:
            yield
        finally:
            self._added.remove(conditions)
            self._loop.call_soon_threadsafe(self._combine, Random(seed))

    def close(self) -> None:
        """End it with all its connections."""
        self._loop.call_soon_threadsafe(self._is_closed.set)
        self._thread.join()

    def _combine(self, random: Random) -> None:
        self._random = random
        self._conditions = LinkConditions(
            is_cut=any(one.is_cut for one in self._added),
            latency_s=sum(one.latency_s for one in self._added),
            jitter_s=sum(one.jitter_s for one in self._added),
            loss=1.0 - math.prod(1.0 - one.loss for one in self._added),
            bandwidth=min(one.bandwidth for one in self._added) if self._added else math.inf,
        )
        if self._conditions.is_cut:
            self._passes.clear()
        else:
            self._passes.set()

    def _run(self) -> None:
        with closing(self._loop):
            self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        async with await asyncio.start_server(self._accept, sock=self._listener):
            await self._is_closed.wait()
            for task in self._connections:
                task.cancel()
            await asyncio.gather(*self._connections, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        try:
            await self._passes.wait()
            # Closed at once if nothing listens there, as when that machine does not run.
            with suppress(OSError):
                await self._connect((reader, writer))
        except asyncio.CancelledError:  # by `close`; asyncio would log it
            pass
        finally:
            self._connections.discard(task)
            writer.close()

    async def _connect(self, here: _Streams) -> None:
        there = await asyncio.open_connection(HOST, self._to)
        directions = [
            asyncio.ensure_future(self._pass_on(here[0], there[1])),
            asyncio.ensure_future(self._pass_on(there[0], here[1])),
        ]
        try:
            await asyncio.wait(directions, return_when=asyncio.FIRST_COMPLETED)
        finally:
            # Neither side of a TLS link goes on when the other one has ended.
            for direction in directions:
                direction.cancel()
            await asyncio.gather(*directions, return_exceptions=True)
            there[1].close()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass on one direction of a connection until it ends."""
        queue: _Queue = asyncio.Queue(_MOST_CHUNKS)
        taking = asyncio.ensure_future(self._take(reader, queue))
        try:
            await self._give(queue, writer)
        finally:
            taking.cancel()
            await asyncio.gather(taking, return_exceptions=True)

    async def _take(self, reader: asyncio.StreamReader, queue: _Queue) -> None:
        """Put what arrives into the queue, each piece with the time at which it is due."""
        due, data = 0.0, b"first"
        while data:
            try:
                data = await reader.read(_CHUNK)
            except OSError:  # reset by the other side
                data = b""
            due = max(due, self._loop.time() + self._draw_delay_s())
            await queue.put((due, data))

    async def _give(self, queue: _Queue, writer: asyncio.StreamWriter) -> None:
        """Pass on what is in the queue when it is due; return at the end of the connection."""
        while True:
            due, data = await queue.get()
            await asyncio.sleep(due - self._loop.time())
            await asyncio.sleep(len(data) / self._conditions.bandwidth)
            await self._passes.wait()
            if not data:
                return
            writer.write(data)
            await writer.drain()

    def _draw_delay_s(self) -> float:
        now = self._conditions
        delay_s = now.latency_s + now.jitter_s * self._random.random()
        return delay_s + (_RETRANSMISSION_S if self._random.random() < now.loss else 0.0)
