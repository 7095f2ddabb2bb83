"""An emulated device for tests of links: it repeats each line that it receives, and can count."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

from cairn.driver.serial_and_tcp import Link
from tests.patience import LIMIT_S


@dataclass
class Parrot:
    """Repeats lines. `count` starts a number every `period_s`; `speak N` changes its speed."""

    period_s: float = 0.01
    speed: int | None = None
    counting: bool = False
    number: int = 0
    next_at: float = math.inf
    power_ons: int = 0
    hang_ups: int = 0
    received: list[bytes] = field(default_factory=list)
    _held: bytes = b""

    def powered_on(self, now: float) -> None:
        self.power_ons += 1
        self.counting, self.next_at, self._held = False, math.inf, b""

    def disconnected(self, now: float) -> None:
        self.hang_ups += 1

    def baud(self) -> int | None:
        return self.speed

    def due(self) -> float:
        return self.next_at

    def tick(self, now: float) -> list[bytes]:
        if now < self.next_at:
            return []
        self.next_at = now + self.period_s
        self.number += 1
        return [b"%d\n" % self.number]

    def receive(self, data: bytes, now: float) -> list[bytes]:
        *lines, self._held = (self._held + data).split(b"\n")
        for line in lines:
            self.received.append(line)
            if line == b"count":
                self.next_at = now
            elif line.startswith(b"speak "):
                self.speed = int(line[6:])
            elif line == b"fail":
                raise RuntimeError("the parrot is dead")
        return [line + b"\n" for line in lines]


def read_until(link: Link, part: bytes) -> bytes:
    """Read until `part` was received; return all received bytes."""
    deadline = time.monotonic() + LIMIT_S
    data = b""
    while part not in data:
        data += link.read(max(0.0, deadline - time.monotonic()))
        assert time.monotonic() < deadline, f"{part!r} was not received, but {data[-200:]!r}"
    return data


def read_count(link: Link, count: int) -> bytes:
    """Read at least `count` bytes."""
    deadline = time.monotonic() + LIMIT_S
    data = b""
    while len(data) < count:
        data += link.read(max(0.0, deadline - time.monotonic()))
        assert time.monotonic() < deadline, f"only {data[-200:]!r} was received"
    return data


def read_until_quiet(link: Link) -> None:
    """Discard what is received until nothing is for a while."""
    deadline = time.monotonic() + LIMIT_S
    while data := link.read(0.1):
        assert time.monotonic() < deadline, f"the line is not quiet, but has {data[-200:]!r}"


def request(link: Link, line: bytes) -> bytes:
    """Send a line; return all bytes received until the device repeats it."""
    link.write(line + b"\n")
    return read_until(link, line + b"\n")
