"""Questions and answers over a link, in SCIP of any version, beside a stream of scans."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass

from cairn.components.hokuyo.replies import Reply, ReplySplitter
from cairn.driver.errors import DeviceError
from cairn.driver.link import Link

_ANSWER_LIMIT_S = 0.5  # sensors answer within milliseconds, but computers may be busy
_LONGEST_ANSWER = 500  # bytes, of those that are no scans
_LOOK_S = 0.1  # how often it is looked whether to stop
_BITS_PER_BYTE = 10  # start, eight of data, stop

TRIES = 3
"""How often a command is sent that every sensor knows."""


class NoAnswer(DeviceError):  # noqa: N818 - it tells what happened
    """A sensor has not answered a command."""


class Stopped(DeviceError):  # noqa: N818 - it tells what happened
    """A question was given up because the driver is to stop."""


@dataclass(frozen=True)
class Arrival:
    """A reply, and when its last byte had come [ns of the system's monotonic clock]."""

    reply: Reply
    at: int


class Dialogue:
    """Sends commands and finds their replies among all that come. One thread at a time."""

    def __init__(self, link: Link, stopping: threading.Event | None = None) -> None:
        """Questions are given up once `stopping` is set."""
        self.link = link
        self.stopping = stopping
        self.heard = 0
        """How many bytes have come so far."""
        self.last = b""
        """What came last."""
        self.answer_limit_s = _ANSWER_LIMIT_S
        """How long an answer is waited for [s]."""
        self._splitter = ReplySplitter()
        self._kept: deque[Arrival] = deque()

    @property
    def noise(self) -> int:
        """How many bytes belonged to no reply so far."""
        return self._splitter.noise

    def set_baud(self, baud: int) -> None:
        """Speak at this speed [bit/s] from now on, and wait as long as it takes there."""
        self.link.set_baud(baud)
        line_s = _LONGEST_ANSWER * _BITS_PER_BYTE / baud if self.link.paced else 0.0
        self.answer_limit_s = _ANSWER_LIMIT_S + line_s

    def ask(self, command: str, tries: int = TRIES) -> Reply:
        """Send a command, and return its reply; other replies are kept for `arrivals`.

        A command or its reply may be damaged on the way, so it is sent several times; no command
        of SCIP does harm if it comes twice. Raises `NoAnswer`, `LinkLost`.
        """
        for _ in range(tries):
            self.send(command)
            reply = self.find(command)
            if reply is not None:
                return reply
        raise NoAnswer(f"{self.link.name}: the sensor does not answer {command}")

    def send(self, command: str) -> None:
        """Send a command without awaiting its reply; raises `LinkLost`."""
        self.link.write(command.encode("ascii") + b"\n")

    def find(self, command: str) -> Reply | None:
        """The reply to a command that was sent, if it comes in time; other replies are kept."""
        echo = command.encode("ascii")
        deadline = time.monotonic() + self.answer_limit_s
        while (left_s := deadline - time.monotonic()) > 0:
            self._look()
            found = None
            for arrival in self._take(min(left_s, _LOOK_S)):
                # What was cut off a stream may stand before the first reply after it.
                if found is None and arrival.reply.echo.endswith(echo):
                    found = arrival.reply
                else:
                    self._kept.append(arrival)
            if found is not None:
                return found
        return None

    def arrivals(self, limit_s: float) -> list[Arrival]:
        """What has come, waiting up to `limit_s` [s] for bytes; raises `LinkLost`."""
        if self._kept:
            kept = list(self._kept)
            self._kept.clear()
            return kept
        return self._take(limit_s)

    def quieten(self, quiet_s: float, limit_s: float) -> None:
        """Throw away all that comes until nothing does for a while, or the limit is over."""
        deadline = time.monotonic() + limit_s
        while self.link.read(quiet_s) and time.monotonic() < deadline:
            self._look()
        self.forget()

    def forget(self) -> None:
        """Throw away all that has come so far."""
        self.link.discard()
        self._splitter.clear()
        self._kept.clear()

    def _look(self) -> None:
        if self.stopping is not None and self.stopping.is_set():
            raise Stopped(f"{self.link.name}: given up, as the driver is to stop")

    def _take(self, limit_s: float) -> list[Arrival]:
        data = self.link.read(limit_s)
        at = time.monotonic_ns()
        self.heard += len(data)
        self.last = data or self.last
        return [Arrival(reply, at) for reply in self._splitter.feed(data)] if data else []
