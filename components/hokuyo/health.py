"""What the driver tells of a sensor's health."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.components.hokuyo.measurement import Measured, Measurement
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import ERROR, OK, WARN

_AS_IT_SAYS = ("LASR", "SCSP", "MESM", "SBPS", "STAT")


@dataclass
class Counts:
    """What had been counted when health was told last."""

    damaged: int = 0
    restarts: int = 0
    left_out: int = 0


class Health:
    """Judges by what came since it judged last."""

    def __init__(self) -> None:
        self._before = Counts()

    def judge(
        self, measurement: Measurement, feed: DeviceFeed[Measured], tolerance: float
    ) -> tuple[int, str]:
        """Level and text: connected at all, anything damaged, rate as it should be."""
        now = Counts(measurement.stream.damaged, measurement.restarts, feed.dropped)
        before, self._before = self._before, now
        if feed.device_error:
            return ERROR, feed.device_error
        hz = feed.hz()
        nominal = nominal_hz(measurement)
        if now.restarts > before.restarts:
            return WARN, "it had fallen silent, and was told to begin anew"
        if now.damaged > before.damaged:
            return (
                WARN,
                f"{now.damaged - before.damaged} damaged replies: check cable and shielding",
            )
        if now.left_out > before.left_out:
            return (
                WARN,
                f"{now.left_out - before.left_out} scans left out: the computer is too busy",
            )
        if nominal and abs(hz - nominal) > tolerance * nominal:
            return (
                WARN,
                f"{hz:.1f} scans a second, but {nominal:.1f} should come{_why(measurement)}",
            )
        return OK, f"{hz:.1f} scans a second"


def nominal_hz(measurement: Measurement) -> float:
    """How many scans a second should come; 0 if that is not known."""
    sensor, request = measurement.sensor, measurement.request
    if sensor is None or request is None:
        return 0.0
    return 1.0 / (sensor.measuring.turn_s * (request.skip + 1))


def values(measurement: Measurement, hz: float) -> dict[str, object]:
    """What is known of the sensor, for diagnostics."""
    stream, sensor, request = measurement.stream, measurement.sensor, measurement.request
    told: dict[str, object] = {
        "rate [Hz]": hz,
        "scans": stream.good,
        "damaged replies": stream.damaged,
        "begun anew after silence": measurement.restarts,
        "connections": measurement.connections,
    }
    told |= {f"status {code}": count for code, count in sorted(stream.statuses.items())}
    if sensor is None:
        return told
    computing_s = sensor.stamping.computing_s
    told |= {
        "port": sensor.link.name,
        "speed [bit/s]": sensor.baud if sensor.link.paced else "not of this line",
        "nominal rate [Hz]": nominal_hz(measurement),
        "model": sensor.measuring.model,
        "vendor": sensor.version.get("VEND", ""),
        "product": sensor.version.get("PROD", ""),
        "firmware": sensor.version.get("FIRM", ""),
        "protocol": sensor.version.get("PROT", ""),
        "serial number": sensor.serial_number,
        "bytes of no reply": sensor.dialogue.noise,
        "clock set": sensor.stamping.jumps,
        "computing [ms]": "not measured" if computing_s is None else 1000.0 * computing_s,
    }
    told |= {f"{key} at start": sensor.state[key] for key in _AS_IT_SAYS if key in sensor.state}
    if request is not None:
        told["command"] = request.command.decode("ascii")
        told["intensity"] = request.intensity
        told["multi-echo"] = request.multi_echo
    return told


def _why(measurement: Measurement) -> str:
    sensor, request = measurement.sensor, measurement.request
    if sensor is None or request is None:
        return ""
    line_s = sensor.line_s(request)
    if line_s * nominal_hz(measurement) < 1.0:
        return ""
    return (
        f": at {sensor.baud} bit/s one takes {line_s:.3f} s; raise baud, cluster or skip, narrow "
        "the angles, or use short_distances"
    )
