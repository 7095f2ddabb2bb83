"""Messages made of what a SCIP sensor has measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo.device_facts import Measuring
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scan_data import NO_ECHO, ScanData
from cairn.schemas.sensor_msgs import LaserEcho, LaserScan, MultiEchoLaserScan
from cairn.schemas.std_msgs import Header

Echo = Literal["first", "last", "strongest"]

# Values below the least distance are codes. What these mean is published for few models; of the
# others all are NaN: not known. UTM-30LX, UST: communication protocol specifications.
_NOTHING_HIT, _TOO_NEAR = {1: math.inf}, {2: -math.inf}
_CODES: dict[str, dict[int, float]] = {
    "UTM": _NOTHING_HIT | _TOO_NEAR,
    "UST": _NOTHING_HIT | _TOO_NEAR,
}


# Two characters go up to 4095, which stands for all that is farther as well.
_SHORT, _SHORT_MOST_MM = 2, 4094


@dataclass(frozen=True)
class ScanShape:
    """What all scans of a request have in common."""

    measuring: Measuring
    request: ScanRequest
    range_max: float | None = None
    """Ranges beyond it count as nothing hit [m]; none: what the sensor says that it measures."""

    def angle(self, step: int) -> float:
        """The direction of a step [rad], to the left of ahead."""
        return 2.0 * math.pi * (step - self.measuring.front) / self.measuring.turn_steps

    def scan(self, data: ScanData, header: Header, echo: Echo) -> LaserScan:
        """One range for each direction: of several echoes the one that is asked for."""
        distances, intensities = _one_echo(data, echo)
        return LaserScan(
            header=header,
            ranges=self._ranges(distances),
            intensities=_plain(intensities),
            **self._limits(),
        )

    def multi_echo_scan(self, data: ScanData, header: Header) -> MultiEchoLaserScan:
        """All echoes of each direction, the nearest first."""
        there = data.distances != NO_ECHO
        ranges = self._ranges(data.distances)
        intensities = () if data.intensities is None else _echoes(data.intensities, there)
        return MultiEchoLaserScan(
            header=header,
            ranges=_echoes(ranges, there),
            intensities=intensities,
            **self._limits(),
        )

    def _limits(self) -> dict[str, float]:
        measuring, request = self.measuring, self.request
        step = 2.0 * math.pi / measuring.turn_steps
        first = self.angle(request.first)
        increment = request.cluster * step
        return {
            "angle_min": first,
            "angle_max": first + (request.values - 1) * increment,
            "angle_increment": increment,
            "time_increment": request.cluster * measuring.turn_s / measuring.turn_steps,
            "scan_time": measuring.turn_s * (request.skip + 1),
            "range_min": measuring.least_mm / 1000.0,
            "range_max": self._most_mm / 1000.0,
        }

    @property
    def _most_mm(self) -> float:
        most = self.measuring.most_mm
        if self.request.encoding == _SHORT:
            most = min(most, _SHORT_MOST_MM)
        return most if self.range_max is None else min(most, self.range_max * 1000.0)

    def _ranges(self, distances: NDArray[np.int32]) -> NDArray[np.float32]:
        """Distances [mm] and codes as ranges [m] of REP 117."""
        ranges = (distances / 1000.0).astype(np.float32)
        ranges[distances > self._most_mm] = np.inf
        failed = distances < self.measuring.least_mm
        if failed.any():
            known = _CODES.get(self.measuring.model[:3], {})
            codes = distances[failed]
            told = np.full(codes.shape, np.nan, np.float32)
            for code, value in known.items():
                told[codes == code] = value
            ranges[failed] = told
        return ranges


def _one_echo(data: ScanData, echo: Echo) -> tuple[NDArray[np.int32], NDArray[np.int32] | None]:
    distances, intensities = data.distances, data.intensities
    rows = np.arange(distances.shape[0])
    if distances.shape[1] == 1 or echo == "first":
        column = np.zeros(distances.shape[0], np.intp)
    elif echo == "last" or intensities is None:
        column = np.count_nonzero(distances != NO_ECHO, axis=1) - 1
    else:
        column = np.argmax(intensities, axis=1)
    one = distances[rows, column]
    return one, None if intensities is None else intensities[rows, column]


def _plain(intensities: NDArray[np.int32] | None) -> NDArray[np.float32]:
    return np.empty(0, np.float32) if intensities is None else intensities.astype(np.float32)


def _echoes(values: NDArray[np.generic], there: NDArray[np.bool_]) -> tuple[LaserEcho, ...]:
    # Parts of one read-only array need no copies of their own: there are a thousand of them.
    flat = values[there].astype(np.float32)
    flat.flags.writeable = False
    ends = np.cumsum(np.count_nonzero(there, axis=1)).tolist()
    return tuple(
        LaserEcho(echoes=flat[begin:end]) for begin, end in zip([0, *ends[:-1]], ends, strict=True)
    )
