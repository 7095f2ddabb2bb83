"""When an emulated sensor's mirror turns, and what its clock shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cairn.components.hokuyo.emulated_models import ScipModel

CLOCK_MS = 1 << 24
"""The sensor's clock counts up to this [ms], which takes 4 h 39 min 37 s, and begins anew."""


@dataclass(frozen=True)
class SensorClock:
    """Counts milliseconds from `start_ms` on since `zero_s`, too fast by `drift_ppm` [1e-6]."""

    zero_s: float
    start_ms: float = 0.0
    drift_ppm: float = 0.0

    def ms(self, at_s: float) -> int:
        """What it shows at that time [s]."""
        passed = (at_s - self.zero_s) * 1000.0 * (1.0 + 1e-6 * self.drift_ppm)
        return math.floor(self.start_ms + passed) % CLOCK_MS


@dataclass(frozen=True)
class Mirror:
    """Turns evenly: turn 0 began, at step 0, at `began_s`; each takes `turn_s` [s]."""

    model: ScipModel
    began_s: float
    turn_s: float

    def began(self, turn: int) -> float:
        """When a turn passes step 0 [s]."""
        return self.began_s + turn * self.turn_s

    def measured(self, turn: int) -> float:
        """When the last step of a turn is measured [s]."""
        return self.began(turn) + self.turn_s * self.model.steps / self.model.turn_steps

    def newest(self, now: float) -> int:
        """The last turn that is measured by then."""
        return math.floor((now - self.measured(0)) / self.turn_s + 1e-6)

    def next(self, now: float) -> int:
        """The first turn that begins then or later."""
        return math.ceil((now - self.began_s) / self.turn_s - 1e-6)
