"""Range scanners as their makers specify them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ScannerModel:
    """Field of view `first` to `last` [rad] in `steps` beams, `turn_s` [s] a turn of the mirror.

    `least`, `most` [m]: range. Deviation: `noise_m` [m], or `noise_share` [1] of the range if that
    is more.
    """

    first: float
    last: float
    steps: int
    turn_s: float
    least: float
    most: float
    noise_m: float
    noise_share: float

    @property
    def increment(self) -> float:
        """Angle between two beams [rad]."""
        return (self.last - self.first) / (self.steps - 1)

    @property
    def time_increment(self) -> float:
        """Time between two beams [s]."""
        return self.turn_s * self.increment / (2.0 * math.pi)


def _model(
    turn_steps: int,
    steps: int,
    rate: float,
    least: float,
    most: float,
    noise: tuple[float, float],
) -> ScannerModel:
    """A model whose full turn has `turn_steps`, of which the middle `steps` are measured."""
    half = math.pi * (steps - 1) / turn_steps
    return ScannerModel(-half, half, steps, 1.0 / rate, least, most, *noise)


MODELS: dict[str, ScannerModel] = {
    # Steps as the devices report them (ARES, AMIN, AMAX). Deviations are half of what the data
    # sheets give as accuracy; the UST's, whose +-40 mm hold for any surface, is that of the UTM.
    "URG-04LX": _model(1024, 682, 10.0, 0.06, 4.095, (0.005, 0.005)),
    "URG-04LX-UG01": _model(1024, 682, 10.0, 0.06, 5.6, (0.015, 0.015)),
    "UTM-30LX": _model(1440, 1081, 40.0, 0.1, 30.0, (0.015, 0.0)),
    "UST-10LX": _model(1440, 1081, 40.0, 0.06, 10.0, (0.015, 0.0)),
    "UST-20LX": _model(1440, 1081, 40.0, 0.06, 20.0, (0.015, 0.0)),
    # An LED scanner for obstacles: coarse, near, and far less exact.
    "PBS-03JN": _model(200, 121, 10.0, 0.2, 3.0, (0.05, 0.05)),
}
