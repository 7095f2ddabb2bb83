"""Health of a scanner, for diagnostics: its level in a sentence, and the values behind it."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.components.hokuyo_scanner.sensor import Measurement, StampedScan
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import ERROR, OK, WARN

_STATE_KEYS = ("LASR", "SCSP", "MESM", "SBPS", "STAT")


@dataclass
class _Counts:
    damaged: int = 0
    restarts: int = 0
    dropped: int = 0


class HealthMonitor:
    """Judges a scanner by what has happened since the last judgment."""

    def __init__(self) -> None:
        self._before = _Counts()

    def judge(
        self, measurement: Measurement, feed: DeviceFeed[StampedScan], tolerance: float
    ) -> tuple[int, str]:
        """Return level and text: errors, restarts, damaged replies, dropped scans, the rate.

        `tolerance`: of the nominal rate, as a share [1].
        """
        now = _Counts(measurement.parser.damaged, measurement.restarts, feed.dropped)
        before, self._before = self._before, now
        if feed.device_error:
            return ERROR, feed.device_error
        hz = feed.hz()
        nominal = nominal_hz(measurement)
        if now.restarts > before.restarts:
            return WARN, "the sensor stopped sending, and got the command to start again"
        if now.damaged > before.damaged:
            return (
                WARN,
                f"{now.damaged - before.damaged} damaged replies; check cable and shielding",
            )
        if now.dropped > before.dropped:
            return (
                WARN,
                f"{now.dropped - before.dropped} scans dropped: the computer is too busy",
            )
        if nominal and abs(hz - nominal) > tolerance * nominal:
            return (
                WARN,
                f"{hz:.1f} scans per second instead of {nominal:.1f}{_slow_line(measurement)}",
            )
        return OK, f"{hz:.1f} scans per second"


def nominal_hz(measurement: Measurement) -> float:
    """Return how many scans per second are expected [Hz]; 0 if that is not known."""
    sensor, request = measurement.sensor, measurement.request
    if sensor is None or request is None:
        return 0.0
    return 1.0 / (sensor.spec.turn_s * (request.skip + 1))


def health_values(measurement: Measurement, hz: float) -> dict[str, object]:
    """Return everything known about the sensor, for diagnostics and `cairn driver probe`."""
    parser, sensor, request = measurement.parser, measurement.sensor, measurement.request
    values: dict[str, object] = {
        "rate [Hz]": hz,
        "scans": parser.good,
        "damaged replies": parser.damaged,
        "restarts after silence": measurement.restarts,
        "connections": measurement.connections,
    }
    values |= {f"status {code}": count for code, count in sorted(parser.statuses.items())}
    if sensor is None:
        return values
    computing_s = sensor.stamper.computing_s
    values |= {
        "port": sensor.link.name,
        "speed [bit/s]": sensor.baud if sensor.link.paced else "not of this line",
        "nominal rate [Hz]": nominal_hz(measurement),
        "model": sensor.spec.model,
        "vendor": sensor.version.get("VEND", ""),
        "product": sensor.version.get("PROD", ""),
        "firmware": sensor.version.get("FIRM", ""),
        "protocol": sensor.version.get("PROT", ""),
        "serial number": sensor.serial_number,
        "bytes of no reply": sensor.client.noise,
        "clock jumps": sensor.stamper.jumps,
        "computing [ms]": "not measured" if computing_s is None else 1000.0 * computing_s,
    }
    values |= {f"{key} at start": sensor.state[key] for key in _STATE_KEYS if key in sensor.state}
    if request is not None:
        values["command"] = request.command.decode("ascii")
        values["intensity"] = request.intensity
        values["multi-echo"] = request.multi_echo
    return values


def _slow_line(measurement: Measurement) -> str:
    """Return the remedy if the line is too slow for the rate."""
    sensor, request = measurement.sensor, measurement.request
    if sensor is None or request is None:
        return ""
    line_s = sensor.line_s(request)
    if line_s * nominal_hz(measurement) < 1.0:
        return ""
    return (
        f": at {sensor.baud} bit/s a scan takes {line_s:.3f} s; raise baud, cluster or skip, "
        "narrow the angles, or use short_distances"
    )
