"""Observations of objects by the camera, as the components that use them receive them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cairn.schemas.cairn_msgs import RecognizedObjectArray

# Deviations of an observation whose sender states no covariance [m], [rad]: several times those of
# the recognizer, so that it has little weight. Chosen by hand; half and double of them change
# nothing in the localizer's benchmarks.
_RANGE_SD, _BEARING_SD = 0.2, math.radians(3.0)


@dataclass(frozen=True)
class Observation:
    """One recognized object: range [m], bearing [rad, left positive] and their variances.

    `alternatives` are other objects that look the same.
    """

    object_id: int
    range_m: float
    bearing: float
    range_variance: float
    bearing_variance: float
    alternatives: tuple[int, ...] = ()


def observations_of(message: RecognizedObjectArray) -> list[Observation]:
    """Return the recognized objects as observations."""
    return [
        Observation(
            object_id=o.object_id,
            range_m=o.range,
            bearing=o.bearing,
            range_variance=float(o.covariance[0]) or _RANGE_SD**2,
            bearing_variance=float(o.covariance[3]) or _BEARING_SD**2,
            alternatives=tuple(o.alternatives.tolist()),
        )
        for o in message.objects
    ]
