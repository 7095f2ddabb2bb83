"""An emulated PBS-03JN: what its line shows, without line or clock, and the room around it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs_scanner.protocol import (
    BAUD,
    DISTANCES,
    LINK,
    LINK_CODE,
    LINK_S,
    RAYS,
    FrameSplitter,
    encode_frame,
    link_request,
)

TURN_S, SLOW_TURN_S = 0.1, 0.11
"""Time of a turn, and in its low-speed mode [s]."""

NOTHING_MM = 0xFFFF
"""Sent where no light comes back."""

_SIGHT_MM = 4000.0
_ANGLES = math.radians(1.8) * (np.arange(RAYS) - (RAYS - 1) // 2)


@dataclass(frozen=True)
class SentDistances:
    """Distances [mm] of all rays as they were sent, and of which turn."""

    turn: int
    distances: NDArray[np.uint16]

    def line(self) -> str:
        """Return a line of JSON."""
        return json.dumps({"turn": self.turn, "distances": self.distances.tolist()})


class EmulatedPbs:
    """The sensor. Implements `cairn.driver.emulator.EmulatedDevice`.

    It holds the link for three seconds, and sends distances only over a link.
    """

    def __init__(
        self,
        *,
        seed: int = 0,
        low_speed: bool = False,
        code: bytes | None = None,
        on_scan: Callable[[SentDistances], None] | None = None,
    ) -> None:
        """`code`: a fixed link code; None: a random one at each power-on."""
        self._seed = seed
        self._random = np.random.default_rng(seed)
        self._turn_s = SLOW_TURN_S if low_speed else TURN_S
        self._fixed_code = code
        self._on_scan = on_scan
        self.powered_on(0.0)

    def powered_on(self, now: float) -> None:
        """Start as after power-on."""
        self._code = self._fixed_code or self._random.bytes(8)
        self._linked_until = -math.inf
        self._on_since = now
        self._splitter = FrameSplitter()

    def disconnected(self, now: float) -> None:
        """Do nothing: its line does not show it; the link ends by itself."""

    def baud(self) -> int:
        """Return its speed [bit/s]."""
        return BAUD

    def due(self) -> float:
        """Return infinity: it only replies."""
        return math.inf

    def tick(self, _: float) -> list[bytes]:
        """Return nothing."""
        return []

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take requests; return the replies. Damaged and unknown ones have none."""
        answers = [self._answer(payload, now) for payload in self._splitter.feed(data)]
        return [encode_frame(answer) for answer in answers if answer is not None]

    def _answer(self, payload: bytes, now: float) -> bytes | None:
        if payload == LINK_CODE:
            return LINK_CODE + self._code
        if payload[:2] == LINK:
            linked = payload == link_request(self._code)
            self._linked_until = now + LINK_S if linked else -math.inf
            return LINK + bytes([linked])
        if payload == DISTANCES and now < self._linked_until:
            return DISTANCES + self._distances(now)
        return None

    def _distances(self, now: float) -> bytes:
        turn = max(0, math.floor((now - self._on_since) / self._turn_s) - 1)
        sent = SentDistances(turn, emulated_room(self._seed, turn, turn * self._turn_s))
        if self._on_scan is not None:
            self._on_scan(sent)
        return sent.distances.astype("<u2").tobytes()


def emulated_room(seed: int, turn: int, began_s: float) -> NDArray[np.uint16]:
    """Return distances [mm] of all rays in a turn, from right to left; no two turns are equal."""
    ahead, left = np.cos(_ANGLES), np.sin(_ANGLES)
    with np.errstate(divide="ignore"):
        walls = np.minimum(
            np.where(ahead > 0, 2400.0, 6000.0) / np.abs(ahead),
            np.where(left > 0, 1900.0, 6000.0) / np.abs(left),
        )
    beside = _ANGLES - 0.9 * math.sin(0.5 * began_s)  # the walker: 1.3 m away, 0.5 m wide
    within = (np.abs(1300.0 * np.sin(beside)) < 250.0) & (np.cos(beside) > 0)
    found = np.where(within, np.minimum(walls, 1100.0), walls)
    random = np.random.default_rng((seed, turn))
    measured = found * (1.0 + random.normal(0.0, 0.01, RAYS))
    return np.where(found > _SIGHT_MM, NOTHING_MM, measured).astype(np.uint16)
