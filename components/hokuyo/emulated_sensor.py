"""The emulated sensor behind its protocol: mirror, laser, clock, and what it sees."""

from __future__ import annotations

import math
from collections import deque

from cairn.components.hokuyo.emulated_asked import Asked
from cairn.components.hokuyo.emulated_facts import Condition
from cairn.components.hokuyo.emulated_mirror import Mirror, SensorClock
from cairn.components.hokuyo.emulated_models import ScipModel
from cairn.components.hokuyo.emulated_record import SentScan
from cairn.components.hokuyo.emulated_scene import Scene

SLOWEST = 10
"""Each level of CR takes one hundredth off the mirror's speed."""


class Sensor:
    """Its state, which commands change; time [s] is given."""

    def __init__(
        self,
        model: ScipModel,
        scene: Scene,
        *,
        baud: int | None,
        clock_start_ms: float,
        drift_ppm: float,
        sums_arrows: bool,
    ) -> None:
        self.model = model
        self.scene = scene
        self.trouble: str | None = None
        """The number of what is wrong with it."""
        self.coming: deque[str] = deque()
        """Statuses that come in place of a stream's next scans."""
        self._initial_baud = baud
        self.deaf_until = -math.inf
        self._clock_start_ms = clock_start_ms
        self._drift_ppm = drift_ppm
        self._sums_arrows = sums_arrows
        self.reset(0.0)

    def powered_on(self, now: float) -> None:
        """Begin as after power-on."""
        self.trouble = None
        self.coming.clear()
        self.deaf_until = -math.inf
        self.reset(now)

    def reset(self, now: float, *, keep_speeds: bool = False) -> None:
        """Begin anew: laser off, clock at its beginning; mirror and line as after power-on."""
        self.laser = False
        self.streaming = False
        self.adjusting = False
        self.asleep = False
        self.sensitive = False
        self.clock = SensorClock(now, self._clock_start_ms, self._drift_ppm)
        self._lit_turn = 0
        if not keep_speeds:
            self.baud = self._initial_baud
            self.level = 0
            self.mirror = Mirror(self.model, now, self.model.turn_s)

    def light(self, now: float) -> None:
        """Switch the laser on; awake, if it was asleep."""
        if not self.laser:
            self._lit_turn = self.mirror.next(now)
        self.laser, self.asleep = True, False

    def darken(self) -> None:
        """Switch the laser off; whatever is being measured ends."""
        self.laser = self.streaming = False

    def fail(self, number: str) -> None:
        """Find something wrong with itself, of that number, and stop."""
        self.trouble = number
        self.darken()

    def turn_at(self, level: int, now: float) -> None:
        """Turn the mirror at another speed."""
        self.level = level
        slower = 1.0 - 0.01 * level
        self.mirror = Mirror(self.model, now, self.model.turn_s / slower)
        self._lit_turn = 0

    def newest_turn(self, now: float) -> int:
        """The last turn that is measured; if the laser is new on, the first one that will be."""
        return max(self.mirror.newest(now), self._lit_turn)

    def scan(self, turn: int, asked: Asked) -> SentScan:
        """What a turn has measured, of that what is asked for."""
        began = self.mirror.began(turn)
        measured = self.scene.turn(turn, began - self.clock.zero_s)
        distances, intensities = asked.of(measured, self.model)
        return SentScan(
            asked, turn, self.clock.ms(began), distances, intensities if asked.intensity else None
        )

    def condition(self, now: float) -> Condition:
        """What II tells of it."""
        return Condition(
            laser=self.laser,
            streaming=self.streaming,
            sensitive=self.sensitive,
            rpm=round(60.0 / self.mirror.turn_s),
            level=self.level,
            baud=self.baud,
            time_ms=self.clock.ms(now),
            trouble=self.trouble,
            sums_arrows=self._sums_arrows,
        )

    def state_number(self) -> str:
        """What %ST tells of it."""
        if self.trouble is not None:
            return "900"
        if self.adjusting:
            return "002"
        if self.asleep:
            return "005"
        if self.streaming:
            return "004"
        return "003" if self.laser else "000"
