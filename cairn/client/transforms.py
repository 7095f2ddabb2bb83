"""The transforms of a robot, as a script reads them: a buffer that a thread fills."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import MutableSet
from contextlib import ExitStack, suppress
from types import SimpleNamespace
from typing import Any

import zenoh

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.message_limits import default_max_bytes
from cairn.client.connection import Connection, SampleQueue
from cairn.errors import CairnError
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.tf2_msgs import TFMessage
from cairn.system.closing import Closing
from cairn.tf import Buffer, ExtrapolationError, InvalidArgumentError, Transform, TransformError

_CHANGING, _STATIC = "tf", "tf_static"
_CLOSE_LIMIT_S = 2.0
_MAX_PUBLISHERS = 1_000  # whose names are kept
_END = SimpleNamespace(payload=b"")

_log = logging.getLogger("cairn.client")


class TransformListener(Closing):
    """Fills a buffer with a robot's transforms until it is closed; `Robot.transforms` returns it.

    It reads the topics `tf` and `tf_static` of the robot and those of ROS, `/tf` and `/tf_static`.
    When topic `clock` sets time back, it clears the buffer.

    Attributes:
        buffer: the transforms; may be used from any thread.
        topics: full names of the topics that it reads.
    """

    def __init__(
        self,
        connection: Connection,
        robot: str,
        buffer: Buffer,
        opened: MutableSet[TransformListener],
    ) -> None:
        self.buffer = buffer
        prefixes = ("/", f"/{robot}/") if robot else ("/",)
        self.topics = tuple(
            f"{prefix}{name}" for prefix in prefixes for name in (_CHANGING, _STATIC)
        )
        self._connection = connection
        self._opened = opened
        self._codec = Codec()
        self._messages: dict[str, type[Any]] = {}  # by the full names of their topics
        self._names: dict[bytes, str] = {}  # of publishers, by their gids
        self._clock: tuple[str, int] | None = None  # the topic, and its time [ns]
        self._changed = threading.Condition()
        self._closed = False
        self._samples = SampleQueue()
        self._stack = ExitStack()
        try:
            for prefix in prefixes:
                self._subscribe(f"{prefix}{CLOCK_TOPIC}", Clock)
                self._subscribe(f"{prefix}{_STATIC}", TFMessage, latched=True)
                self._subscribe(f"{prefix}{_CHANGING}", TFMessage)
        except BaseException:
            self._stack.close()
            raise
        self._thread = threading.Thread(target=self._run, name="cairn transforms", daemon=True)
        self._thread.start()
        opened.add(self)

    def close(self) -> None:
        """Stop reading; the buffer keeps its transforms."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self._changed.notify_all()
        self._opened.discard(self)
        self._stack.close()
        self._samples.put(_END)
        if threading.current_thread() is not self._thread:
            self._thread.join(_CLOSE_LIMIT_S)

    def now_ns(self) -> int:
        """Return the robot's time [ns]: that of topic `clock` if it is published, or the system's.

        Stamps of transforms are in this time.
        """
        clock = self._clock
        return time.time_ns() if clock is None else clock[1]

    def lookup(
        self, target: str, source: str, time_ns: int | None = None, *, timeout_s: float = 5.0
    ) -> Transform:
        """Return the transform target <- source as `Buffer.lookup`; wait for it up to a time limit.

        It does not wait for a time before the oldest transform.

        Raises `CairnError` if no transform at all arrives within `timeout_s` [s], otherwise what
        `Buffer.lookup` raises then.
        """
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while True:
                try:
                    return self.buffer.lookup(target, source, time_ns)
                except InvalidArgumentError:
                    raise
                except TransformError as error:
                    if (
                        time_ns is not None
                        and isinstance(error, ExtrapolationError)
                        and error.requested_ns < error.oldest_ns
                    ):
                        raise  # what is too old does not arrive any more
                    left_s = deadline - time.monotonic()
                    if left_s <= 0 or self._closed:
                        if not self.buffer.frames():
                            raise self._nothing(timeout_s) from error
                        raise
                self._changed.wait(min(left_s, threading.TIMEOUT_MAX))

    def await_transforms(self, timeout_s: float = 5.0) -> None:
        """Wait until a transform has arrived; raise `CairnError` after the time limit [s]."""
        with self._changed:
            self._changed.wait_for(lambda: self.buffer.frames() or self._closed, timeout_s)
            if not self.buffer.frames():
                raise self._nothing(timeout_s)

    def _nothing(self, timeout_s: float) -> CairnError:
        return CairnError(
            f"no transform within {timeout_s:g} s on {', '.join(self.topics)}; start what "
            "publishes them, such as a base or a localizer, or name another robot or domain"
        )

    def _subscribe(self, topic: str, message: type[Any], *, latched: bool = False) -> None:
        self._messages[topic] = message
        key = keys.message_key(self._connection.domain, topic, message)
        if latched:
            # Finds the caches of publishers that start later, too. It delivers nothing until all
            # caches have replied, which a stopped process delays; `listen` asks them once itself.
            handler = zenoh.handlers.Callback(self._samples.put, indirect=False)
            subscriber = self._connection.subscriber(key, handler, latched=True)
            self._stack.callback(subscriber.undeclare)
        self._stack.enter_context(
            self._connection.listen(key, latched=latched, samples=self._samples)
        )

    def _run(self) -> None:
        while True:
            sample = self._samples.get()
            if sample is _END:
                return
            try:
                self._receive(sample)
            except Exception:  # `on_problem` of the user may fail in any way; the next follows
                _log.exception("a transform could not be added")

    def _receive(self, sample: Any) -> None:
        topic = "/" + "/".join(str(sample.key_expr).split("/")[1:-2])
        message = self._messages.get(topic)
        if message is None:  # on a key with wildcards, as only hostile programs publish
            return
        if len(sample.payload) > default_max_bytes(message):
            return
        try:
            received = self._codec.decode(message, sample.payload.to_bytes())
        except InvalidMessage as error:
            _log.debug("%s: invalid message: %s", topic, error)
            return
        if isinstance(received, Clock):
            self._set_clock(topic, to_ns(received.clock))
            return
        publisher = self._publisher(topic, sample)
        if keys.own_name(publisher, topic) in self.topics:
            return  # it has arrived on the robot's own topic
        is_static = topic.endswith(f"/{_STATIC}")
        self.buffer.add(received, static=is_static, publisher=publisher)
        with self._changed:
            self._changed.notify_all()

    def _set_clock(self, topic: str, now: int) -> None:
        if self._clock is not None and topic == self._clock[0]:
            if now < self._clock[1]:
                self.buffer.clear()
        elif self._clock is not None and len(topic) < len(self._clock[0]):
            return  # /clock, beside the robot's own
        self._clock = topic, now

    def _publisher(self, topic: str, sample: Any) -> str:
        """Return the full name of the node that published a sample; empty if that is unknown."""
        sent = keys.Attachment.of(sample)
        if sent is None:
            return ""
        if sent.gid not in self._names and len(self._names) < _MAX_PUBLISHERS:
            self._names[sent.gid] = ""
            with suppress(CairnError, zenoh.ZError):  # the router is busy, the session is closed
                for end in self._connection.endpoints(topic):
                    if keys.gid(keys.token_key(end)) == sent.gid:
                        self._names[sent.gid] = end.node.name
        return self._names.get(sent.gid, "")
