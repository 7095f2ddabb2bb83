"""Faults of an emulated device's line, to order and at random."""

from __future__ import annotations

from collections import Counter
from typing import Literal, get_args

import numpy as np

FrameFault = Literal["bad_sum", "cut", "garbage", "drop"]
"""What may happen to a frame: a byte is changed, a part is missing, noise comes before it, or it
does not come at all."""

FRAME_FAULTS: tuple[FrameFault, ...] = get_args(FrameFault)


class FrameFaults:
    """Spoils frames: those to order next, and a share of all at random."""

    def __init__(self, shares: dict[FrameFault, float], random: np.random.Generator) -> None:
        """`shares`: of all frames, those that each fault befalls [1]."""
        self._shares = shares
        self._random = random
        self._ordered: list[FrameFault] = []
        self.done: Counter[str] = Counter()
        """How many frames each fault has befallen."""

    def order(self, fault: FrameFault, frames: int = 1) -> None:
        """Spoil so many of the next frames."""
        self._ordered += [fault] * frames

    def spoil(self, frame: bytes) -> bytes:
        """What of a frame goes onto the line."""
        for fault in self._due():
            self.done[fault] += 1
            frame = self._spoiled(fault, frame)
        return frame

    def _due(self) -> list[FrameFault]:
        due = [self._ordered.pop(0)] if self._ordered else []
        chance = {fault: share for fault, share in self._shares.items() if share > 0}
        return due + [fault for fault, share in chance.items() if self._random.random() < share]

    def _spoiled(self, fault: FrameFault, frame: bytes) -> bytes:
        if not frame:
            return frame
        at = int(self._random.integers(len(frame)))
        match fault:
            case "bad_sum":
                wrong = frame[at] ^ (1 << int(self._random.integers(8)))
                return frame[:at] + bytes([wrong]) + frame[at + 1 :]
            case "cut":
                return frame[:at] + frame[at + 1 + int(self._random.integers(len(frame) - at)) :]
            case "garbage":
                return self._random.bytes(1 + int(self._random.integers(200))) + frame
            case "drop":
                return b""
