"""Scans of a PBS-03JN as messages: ranges [m] of REP 117."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs_scanner.protocol import RAYS
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

RANGE_MIN = 0.2
"""The least distance that it measures [m]."""

TURN_S = 0.1
"""Time of a turn of its mirror [s]."""


@dataclass(frozen=True)
class PbsMessages:
    """Makes messages of scans; has the angle between rays [rad] and the farthest range [m]."""

    increment: float
    range_max: float

    @property
    def sweep_s(self) -> float:
        """Time from the first ray to the last [s]."""
        return TURN_S * (RAYS - 1) * self.increment / (2.0 * math.pi)

    def scan(self, distances: NDArray[np.int32], header: Header) -> LaserScan:
        """Return a scan of distances [mm], where 0 means a failure; the middle ray is ahead."""
        ranges = (distances / 1000.0).astype(np.float32)
        ranges[distances < 1000.0 * RANGE_MIN] = -np.inf
        ranges[distances > 1000.0 * self.range_max] = np.inf
        ranges[distances == 0] = np.nan
        half = (RAYS - 1) // 2 * self.increment
        return LaserScan(
            header=header,
            angle_min=-half,
            angle_max=half,
            angle_increment=self.increment,
            time_increment=self.sweep_s / (RAYS - 1),
            scan_time=TURN_S,
            range_min=RANGE_MIN,
            range_max=self.range_max,
            ranges=ranges,
        )
