"""One browser: its subscriptions, and what waits to be sent to it, within bounds.

A browser that reads slowly gets fewer messages. Each subscription keeps the newest ones, so what
arrives is never older than the link requires; other browsers and the robot do not notice.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any, Final, Literal

from cairn.console.protocol import CONSOLE, ClientChannel, message_data, status, to_text
from cairn.console.source import Channel, Message

MAX_SUBSCRIPTIONS: Final = 500

_DATA_BYTES: Final = 16 << 20
"""Messages that wait for one browser [bytes]; a single one, such as a map, may be longer."""

_TEXT_BYTES: Final = 8 << 20
"""Answers that wait for one browser [bytes]; a browser that does not read them is disconnected."""

_SLACK_S: Final = 0.002
"""Messages at exactly the rate of a limit are not dropped for arriving a little early."""

Send = Callable[[str | bytes], Awaitable[None]]


class BrowserSubscription:
    """One subscription of a browser.

    Attributes:
        id: chosen by the browser.
        jpeg: whether images are sent as JPEG.
        dropped: messages that were replaced by newer ones before they could be sent.
        is_queued: whether its browser will look for its messages.
        has_failed: whether an image could not be encoded, which is reported once.
    """

    def __init__(
        self, id_: int, channel: Channel, *, max_hz: float | None = None, jpeg: bool = False
    ) -> None:
        self.id = id_
        self.channel = channel
        self.jpeg = jpeg
        self.dropped = 0
        self.bytes = 0
        self.is_queued = False
        self.has_failed = False
        self._interval_s = 0.0 if max_hz is None else 1.0 / max_hz
        self._depth = channel.depth if max_hz is None else 1
        self._pending: deque[Message] = deque()
        self._due_s = 0.0

    def __len__(self) -> int:
        return len(self._pending)

    def put(self, message: Message) -> None:
        """Add a message; the oldest ones go if there are more than the channel's depth."""
        self._pending.append(message)
        self.bytes += len(message.payload)
        while len(self._pending) > self._depth:
            self.drop_oldest()

    def drop_oldest(self) -> None:
        """Drop the oldest message."""
        self.bytes -= len(self._pending.popleft().payload)
        self.dropped += 1

    def wait_s(self, now: float) -> float:
        """Return how long the next message has to wait for the limit of the rate [s]."""
        return max(0.0, self._due_s - _SLACK_S - now)

    def is_free(self, now: float) -> bool:
        """Return whether a message put now would be sent at once, but for other topics."""
        return not self._pending and self.wait_s(now) == 0.0

    def take(self, now: float) -> Message:
        """Remove and return the oldest message."""
        message = self._pending.popleft()
        self.bytes -= len(message.payload)
        is_steady = now - self._due_s < self._interval_s / 2
        self._due_s = (self._due_s if is_steady else now) + self._interval_s
        return message


class Browser:
    """A connection of a page or of a Foxglove client. For the event loop's thread.

    Attributes:
        id: number of the connection, unique in the hub.
        protocol: the subprotocol.
        may: "steer", or "watch" for one that may change nothing.
        subscriptions: by the id that the browser has chosen.
        client_channels: on which it publishes, by its id.
        parameter_names: parameters whose changes it receives; None for all.
        wants_graph: whether it receives the connection graph.
        invalid: number of invalid messages that it has sent.
        calls: number of its calls that are under way.
    """

    def __init__(self, id_: int, protocol: str, may: Literal["watch", "steer"], send: Send) -> None:
        self.id = id_
        self.protocol = protocol
        self.may = may
        self.subscriptions: dict[int, BrowserSubscription] = {}
        self.client_channels: dict[int, ClientChannel] = {}
        self.parameter_names: set[str] | None = set()
        self.wants_graph = False
        self.invalid = 0
        self.calls = 0
        self._send = send
        self._texts: deque[str | bytes] = deque()
        self._text_bytes = 0
        self._events: dict[str, str] = {}
        self._ready: deque[BrowserSubscription] = deque()  # those with messages, in turn
        self._waiting: set[BrowserSubscription] = set()  # for the limit of their rate
        self._data_bytes = 0
        self._wake = asyncio.Event()
        self._overflowed = False

    @property
    def is_console(self) -> bool:
        """Whether this is Cairn's own page, which understands events and calls."""
        return self.protocol == CONSOLE

    def send(self, message: dict[str, Any]) -> None:
        """Send a JSON message."""
        self._queue(to_text(message))

    def send_binary(self, data: bytes) -> None:
        """Send a binary message that must not be dropped."""
        self._queue(data)

    def send_status(self, level: int, text: str) -> None:
        """Send a remark for people."""
        self.send(status(level, text))

    def send_event(self, name: str, text: str, key: str = "") -> None:
        """Send an event (JSON); one of the same key that has not been sent yet is replaced.

        The key is by default its name. Clients of Foxglove get no events.
        """
        if self.is_console:
            self._events[key or name] = text
            self._wake.set()

    def offer(self, subscription: BrowserSubscription, message: Message) -> None:
        """Send a message of a channel if the browser reads fast enough; drop older ones if not."""
        if self.subscriptions.get(subscription.id) is not subscription:
            return  # it has ended while the image was encoded
        before = subscription.bytes
        if not subscription.is_queued:
            subscription.is_queued = True
            self._ready.append(subscription)
        subscription.put(message)
        self._data_bytes += subscription.bytes - before
        while self._data_bytes > _DATA_BYTES:
            longest = max(self.subscriptions.values(), key=_droppable_bytes)
            if not _droppable_bytes(longest):
                break
            before = longest.bytes
            longest.drop_oldest()
            self._data_bytes += longest.bytes - before
        self._wake.set()

    def remove(self, subscription_id: int) -> BrowserSubscription | None:
        """End a subscription and return it; None if there is none."""
        subscription = self.subscriptions.pop(subscription_id, None)
        if subscription is not None:
            self._data_bytes -= subscription.bytes
            self._waiting.discard(subscription)
            if subscription in self._ready:
                self._ready.remove(subscription)
        return subscription

    async def pump(self) -> str:
        """Send what waits, until the browser cannot keep up with the answers; return the reason."""
        while not self._overflowed:
            frame = self._next_frame()
            if frame is None:
                await self._wake.wait()
                self._wake.clear()
            else:
                await self._send(frame)
        return f"more than {_TEXT_BYTES >> 20} MiB of answers are waiting to be read"

    def _queue(self, frame: str | bytes) -> None:
        self._texts.append(frame)
        self._text_bytes += len(frame)
        self._overflowed |= self._text_bytes > _TEXT_BYTES
        self._wake.set()

    def _next_frame(self) -> str | bytes | None:
        """Return what to send next: answers, then events, then messages of each topic in turn."""
        if self._texts:
            frame = self._texts.popleft()
            self._text_bytes -= len(frame)
            return frame
        if self._events:
            return self._events.pop(next(iter(self._events)))
        loop = asyncio.get_running_loop()
        while self._ready:
            subscription = self._ready.popleft()
            if not len(subscription):
                subscription.is_queued = False
                continue
            if wait_s := subscription.wait_s(loop.time()):
                self._waiting.add(subscription)
                loop.call_later(wait_s, self._resume, subscription)
                continue
            message = subscription.take(loop.time())
            self._data_bytes -= len(message.payload)
            self._ready.append(subscription)
            return message_data(subscription.id, message.time_ns, message.payload)
        return None

    def _resume(self, subscription: BrowserSubscription) -> None:
        if subscription in self._waiting:
            self._waiting.discard(subscription)
            self._ready.append(subscription)
            self._wake.set()


def _droppable_bytes(subscription: BrowserSubscription) -> int:
    """Return the bytes that a subscription can lose: not the newest message of a latched topic."""
    if subscription.channel.latched and len(subscription) == 1:
        return 0
    return subscription.bytes
