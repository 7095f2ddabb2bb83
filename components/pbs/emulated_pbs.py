"""An emulated PBS-03JN: what its line shows, without line or clock."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs import messages
from cairn.components.pbs.emulated_scene import room
from cairn.components.pbs.frames import FrameSplitter, framed

TURN_S, SLOW_TURN_S = 0.1, 0.11
"""Time of a turn, and in its low-speed mode [s]."""


@dataclass(frozen=True)
class SentDistances:
    """Distances [mm] of all rays as they were sent, and of which turn."""

    turn: int
    distances: NDArray[np.uint16]

    def line(self) -> str:
        """As a line of JSON."""
        return json.dumps({"turn": self.turn, "distances": self.distances.tolist()})


Scene = Callable[[int, float], NDArray[np.uint16]]
"""What turn `n`, which began at a time [s], measures: distances [mm] of all rays."""


class EmulatedPbs:
    """The sensor. Implements `cairn.driver.emulator.EmulatedDevice`.

    It holds the link for three seconds, and tells distances to nobody without one.
    """

    def __init__(
        self,
        *,
        scene: Scene | None = None,
        seed: int = 0,
        low_speed: bool = False,
        code: bytes | None = None,
        on_scan: Callable[[SentDistances], None] | None = None,
    ) -> None:
        """`code`: the link code, if it is not to be a random one at each power-on."""
        self._scene = scene or (lambda turn, began_s: room(seed, turn, began_s))
        self._random = np.random.default_rng(seed)
        self._turn_s = SLOW_TURN_S if low_speed else TURN_S
        self._fixed_code = code
        self._on_scan = on_scan
        self.powered_on(0.0)

    def powered_on(self, now: float) -> None:
        """Begin as after power-on."""
        self._code = self._fixed_code or self._random.bytes(8)
        self._linked_until = -math.inf
        self._on_since = now
        self._splitter = FrameSplitter()

    def disconnected(self, now: float) -> None:
        """Its line does not tell; the link ends by itself."""

    def baud(self) -> int:
        """Its speed [bit/s]."""
        return messages.BAUD

    def due(self) -> float:
        """Never: it speaks when it is asked."""
        return math.inf

    def tick(self, now: float) -> list[bytes]:  # noqa: ARG002 - as every emulated device
        """Nothing."""
        return []

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take requests; what is answered. What is damaged, or not known, is not."""
        answers = [self._answer(payload, now) for payload in self._splitter.feed(data)]
        return [framed(answer) for answer in answers if answer is not None]

    def _answer(self, payload: bytes, now: float) -> bytes | None:
        if payload == messages.LINK_CODE:
            return messages.LINK_CODE + self._code
        if payload[:2] == messages.LINK:
            linked = payload == messages.link_request(self._code)
            self._linked_until = now + messages.LINK_S if linked else -math.inf
            return messages.LINK + bytes([linked])
        if payload == messages.DISTANCES and now < self._linked_until:
            return messages.DISTANCES + self._distances(now)
        return None

    def _distances(self, now: float) -> bytes:
        turn = max(0, math.floor((now - self._on_since) / self._turn_s) - 1)
        sent = SentDistances(turn, self._scene(turn, turn * self._turn_s))
        if self._on_scan is not None:
            self._on_scan(sent)
        return sent.distances.astype("<u2").tobytes()
