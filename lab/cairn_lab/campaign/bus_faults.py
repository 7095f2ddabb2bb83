"""Faults on the bus: a second writer publishes wrong messages, or floods a topic."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from random import Random
from typing import Literal

import zenoh
from pydantic import Field

from cairn.bus.keys import Attachment
from cairn.runtime.parameters import Config
from cairn_lab.campaign.fault import Fault, Injection, SkippedFault
from cairn_lab.campaign.parameters import Duration, Patterns
from cairn_lab.campaign.robot import CampaignRobot

_CAPTURE_S = 0.3
_LONGEST_GARBAGE = 2000  # bytes
_BATCH_S = 0.01

Content = Literal["empty", "garbage", "changed", "repeated"]


class Topics(Config):
    """The topics that may be drawn, and what is published on them."""

    topics: Patterns = Field(
        ("*",), description="Topics that components subscribe to, without the robot's name."
    )
    exclude: Patterns = Field((), description="Topics not to draw, as patterns.")
    contents: tuple[Content, ...] = Field(
        ("empty", "garbage", "changed", "repeated"),
        min_length=1,
        description="What may be published: no bytes; random bytes; a message of the topic with "
        "one byte changed; a message of the topic again. Before the first message: random bytes.",
    )


class WrongMessageConfig(Topics):
    """Parameters of `wrong_message`."""

    messages: int = Field(20, ge=1, le=1000, description="Number of messages.")


class FloodConfig(Topics, Duration):
    """Parameters of `flood`."""

    rate: float = Field(10_000.0, gt=0, le=100_000, description="Messages per second [Hz].")


class WrongMessage(Fault):
    """Publish wrong messages on a topic, as a program beside the robot."""

    config_type = WrongMessageConfig
    config: WrongMessageConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Publish them at once."""
        writer = _Writer(robot, self.config, random)
        for _ in range(self.config.messages):
            writer.put()
        yield Injection(writer.topic, f"published {self.config.messages} times {writer.what}")


class Flood(Fault):
    """Publish on a topic as fast as no component should, as a program beside the robot."""

    config_type = FloodConfig
    config: FloodConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Publish on a thread until the fault's end."""
        writer = _Writer(robot, self.config, random)
        lasts_s = self.config.draw(random)
        is_over = threading.Event()
        thread = threading.Thread(
            target=writer.repeat, args=(self.config.rate, is_over.wait), name="flood", daemon=True
        )
        injection = Injection(writer.topic, "", lasts_s)
        injection.effect = f"flooding with {writer.what} for {lasts_s:g} s"
        began = time.monotonic()
        thread.start()
        try:
            yield injection
        finally:
            is_over.set()
            thread.join()
            took_s = time.monotonic() - began
            rate = writer.count / took_s
            injection.effect = f"flooded with {writer.what} for {took_s:.1f} s, {rate:.0f} per s"


class _Writer:
    """Publishes on a topic that is not its own."""

    def __init__(self, robot: CampaignRobot, config: Topics, random: Random) -> None:
        topics = robot.subscribed_topics(config.topics, config.exclude)
        if not topics:
            raise SkippedFault(f"components subscribe to no topic {', '.join(config.topics)}")
        self.topic, self._key = random.choice(topics)
        self._session = robot.client.connection.session
        content = random.choice(config.contents)
        seed = random.getrandbits(32)
        self._random = Random(seed)
        self._gid = self._random.randbytes(16)
        robot.forgers.add(self._gid)
        self.count = 0
        self._original: bytes | None = None
        if content in ("changed", "repeated"):
            self._original = _captured(self._session, self._key)
            if not self._original:
                content = "garbage"
        self._content = content
        self.what = {
            "empty": "no bytes",
            "garbage": "random bytes",
            "changed": "a message with one byte changed",
            "repeated": "a message of another writer",
        }[content]

    def put(self) -> None:
        """Publish one message."""
        self.count += 1
        attachment = Attachment(self.count, time.time_ns(), self._gid).encode()
        self._session.put(self._key, self._payload(), attachment=attachment)

    def repeat(self, rate: float, wait: Callable[[float], bool]) -> None:
        """Publish at a rate [Hz] until `wait` returns True."""
        began = time.monotonic()
        while not wait(_BATCH_S):
            due = (time.monotonic() - began) * rate
            while self.count < due:
                self.put()
                if self.count % 100 == 0 and wait(0.0):
                    return

    def _payload(self) -> bytes:
        random = self._random
        match self._content:
            case "empty":
                return b""
            case "garbage":
                return random.randbytes(random.randrange(1, _LONGEST_GARBAGE))
        assert self._original is not None
        data = bytearray(self._original)
        if self._content == "changed":
            data[random.randrange(len(data))] ^= random.randrange(1, 256)
        return bytes(data)


def _captured(session: zenoh.Session, key: str) -> bytes | None:
    """Return the next message on a key; None if there is none within a moment."""
    arrived = threading.Event()
    found: list[bytes] = []

    def receive(sample: zenoh.Sample) -> None:
        if not found:
            found.append(sample.payload.to_bytes())
            arrived.set()

    subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))
    try:
        arrived.wait(_CAPTURE_S)
    finally:
        subscriber.undeclare()
    return found[0] if found else None
