"""Scans of a SCIP sensor as messages: ranges [m] of REP 117, angles [rad], echoes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo_scanner.protocol import NO_ECHO, ScanData, ScanRequest, SensorSpec
from cairn.schemas.sensor_msgs import LaserEcho, LaserScan, MultiEchoLaserScan
from cairn.schemas.std_msgs import Header

Echo = Literal["first", "last", "strongest"]

# Values below the least distance are codes. Their meaning is published for few models; those of
# other models become NaN: not known. UTM-30LX, UST: communication protocol specifications.
_NOTHING_HIT, _TOO_NEAR = {1: math.inf}, {2: -math.inf}
_CODES: dict[str, dict[int, float]] = {
    "UTM": _NOTHING_HIT | _TOO_NEAR,
    "UST": _NOTHING_HIT | _TOO_NEAR,
}


# Two characters go up to 4095, which also stands for everything farther.
_SHORT, _SHORT_MOST_MM = 2, 4094


@dataclass(frozen=True)
class ScanMessages:
    """Makes the messages of all scans of one request."""

    spec: SensorSpec
    request: ScanRequest
    range_max: float | None = None
    """Ranges beyond it count as nothing hit [m]; None: the limit that the sensor reports."""

    def angle(self, step: int) -> float:
        """Return the direction of a step [rad], to the left of ahead."""
        return 2.0 * math.pi * (step - self.spec.front) / self.spec.turn_steps

    def scan(self, data: ScanData, header: Header, echo: Echo) -> LaserScan:
        """Return one range per direction; of several echoes the chosen one."""
        distances, intensities = _one_echo(data, echo)
        return LaserScan(
            header=header,
            ranges=self._ranges(distances),
            intensities=_plain(intensities),
            **self._limits(),
        )

    def multi_echo_scan(self, data: ScanData, header: Header) -> MultiEchoLaserScan:
        """Return all echoes of each direction, the nearest first."""
        is_echo = data.distances != NO_ECHO
        ranges = self._ranges(data.distances)
        intensities = () if data.intensities is None else _echoes(data.intensities, is_echo)
        return MultiEchoLaserScan(
            header=header,
            ranges=_echoes(ranges, is_echo),
            intensities=intensities,
            **self._limits(),
        )

    def _limits(self) -> dict[str, float]:
        spec, request = self.spec, self.request
        step = 2.0 * math.pi / spec.turn_steps
        first = self.angle(request.first)
        increment = request.cluster * step
        return {
            "angle_min": first,
            "angle_max": first + (request.values - 1) * increment,
            "angle_increment": increment,
            "time_increment": request.cluster * spec.turn_s / spec.turn_steps,
            "scan_time": spec.turn_s * (request.skip + 1),
            "range_min": spec.least_mm / 1000.0,
            "range_max": self._most_mm / 1000.0,
        }

    @property
    def _most_mm(self) -> float:
        most = self.spec.most_mm
        if self.request.encoding == _SHORT:
            most = min(most, _SHORT_MOST_MM)
        return most if self.range_max is None else min(most, self.range_max * 1000.0)

    def _ranges(self, distances: NDArray[np.int32]) -> NDArray[np.float32]:
        """Convert distances [mm] and codes to ranges [m] of REP 117."""
        ranges = (distances / 1000.0).astype(np.float32)
        ranges[distances > self._most_mm] = np.inf
        failed = distances < self.spec.least_mm
        if failed.any():
            known = _CODES.get(self.spec.model[:3], {})
            codes = distances[failed]
            meaning = np.full(codes.shape, np.nan, np.float32)
            for code, value in known.items():
                meaning[codes == code] = value
            ranges[failed] = meaning
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


def _echoes(values: NDArray[np.generic], is_echo: NDArray[np.bool_]) -> tuple[LaserEcho, ...]:
    # Parts of one read-only array need no copies of their own: there are a thousand of them.
    flat = values[is_echo].astype(np.float32)
    flat.flags.writeable = False
    ends = np.cumsum(np.count_nonzero(is_echo, axis=1)).tolist()
    return tuple(
        LaserEcho(echoes=flat[begin:end]) for begin, end in zip([0, *ends[:-1]], ends, strict=True)
    )
