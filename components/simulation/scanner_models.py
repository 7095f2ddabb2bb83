"""Range scanners as their makers specify them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ScannerModel:
    """Field of view `first` to `last` [rad] in `steps` beams, `turn_s` [s] a turn of the mirror.

    `least`, `most` [m]: range; `noise_m` [m] and `noise_share` [1] of the range: deviation.
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
    degrees: float, steps: int, rate: float, least: float, most: float, noise: tuple[float, float]
) -> ScannerModel:
    half = math.radians(degrees) / 2.0
    return ScannerModel(-half, half, steps, 1.0 / rate, least, most, *noise)


MODELS: dict[str, ScannerModel] = {
    # Accuracy as in the data sheets (Hokuyo), taken as about two standard deviations.
    "URG-04LX": _model(239.77, 682, 10.0, 0.06, 4.095, (0.005, 0.005)),
    "URG-04LX-UG01": _model(239.77, 682, 10.0, 0.06, 5.6, (0.015, 0.010)),
    "UTM-30LX": _model(270.0, 1081, 40.0, 0.1, 30.0, (0.015, 0.0)),
    "UST-10LX": _model(270.0, 1081, 40.0, 0.06, 10.0, (0.015, 0.0)),
    "UST-20LX": _model(270.0, 1081, 40.0, 0.06, 20.0, (0.015, 0.0)),
    "PBS-03JN": _model(216.0, 121, 5.0, 0.2, 3.0, (0.02, 0.03)),
}
