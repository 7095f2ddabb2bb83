"""The commands of an emulated SCIP 2 sensor that do not measure, and their statuses."""

from __future__ import annotations

import math

from cairn.components.hokuyo import emulated_facts as facts
from cairn.components.hokuyo.emulated_sensor import SLOWEST, Sensor
from cairn.components.hokuyo.scip_text import encode_number, with_sum

COMMANDS = frozenset(
    ("VV", "PP", "II", "BM", "QT", "RS", "RT", "RB", "TM", "SS", "CR", "HS", "DB", "%ST", "%SL")
)

BAUDS = (19200, 38400, 57600, 115200, 250000, 500000, 750000)
"""Speeds of RS-232 that sensors know [bit/s]."""

REBOOT_S = 1.0
"""For so long a sensor that boots hears nothing [s]."""

_REBOOT_WITHIN_S = 1.0  # RB must come twice within this

# What DB has a stream tell in place of its next scans: a malfunction is verified and turns out to
# be none, or one that stays; or there is one at once.
_SIMULATED = {
    "02": (),
    "03": ("21", "98"),
    "04": ("21", "50"),
    "05": ("50",),
    "10": (),
}

Outcome = tuple[str, list[bytes]]
"""A status, and the lines that come after it."""


class Commands:
    """What each of the `COMMANDS` does to the sensor, and how it is answered."""

    def __init__(self, sensor: Sensor, serial_number: str) -> None:
        self._sensor = sensor
        self._serial_number = serial_number
        self._reboot_asked = -math.inf

    def run(self, name: str, parameters: str, now: float) -> Outcome:
        """Do what a command says, or refuse it."""
        sensor = self._sensor
        first = sensor.model.generation == "first"
        if name not in sensor.model.commands:
            return "0F" if sensor.model.generation == "UST" else "0E", []
        if sensor.adjusting and first and name != "TM":
            return "0E", []
        if sensor.adjusting and name in ("BM", "QT"):
            return "10", []
        if sensor.trouble is not None and not first and name in ("BM", "QT", "RS", "TM"):
            return "0L", []
        return self._run(name, parameters, now)

    def _run(self, name: str, parameters: str, now: float) -> Outcome:
        sensor = self._sensor
        match name:
            case "VV":
                return "00", facts.version(sensor.model, self._serial_number)
            case "PP":
                return "00", facts.parameters(sensor.model)
            case "II":
                return "00", facts.state(sensor.model, sensor.condition(now))
            case "BM":
                return self._light(now), []
            case "QT":
                sensor.darken()
            case "RS":
                sensor.reset(now)
            case "RT":
                sensor.reset(now, keep_speeds=True)
            case "RB":
                return self._reboot(now), []
            case "TM":
                return self._adjust(parameters, now)
            case "SS":
                return self._set_baud(parameters), []
            case "CR":
                return self._turn_at(parameters, now), []
            case "HS":
                return self._set_sensitive(parameters), []
            case "DB":
                return self._simulate(parameters), []
            case "%ST":
                return "00", [with_sum(sensor.state_number().encode())]
            case "%SL":
                sensor.darken()
                sensor.asleep = True
        return "00", []

    def _light(self, now: float) -> str:
        if self._sensor.trouble is not None:
            return "01"
        if self._sensor.laser:
            return "02"
        self._sensor.light(now)
        return "00"

    def _reboot(self, now: float) -> str:
        if now - self._reboot_asked > _REBOOT_WITHIN_S:
            self._reboot_asked = now
            return "01"
        self._reboot_asked = -math.inf
        self._sensor.powered_on(now)
        self._sensor.deaf_until = now + REBOOT_S
        return "00"

    def _adjust(self, parameters: str, now: float) -> Outcome:
        """TM: the laser rests while host and sensor compare their clocks."""
        sensor = self._sensor
        if parameters not in ("0", "1", "2"):
            return "01", []
        if parameters == "1":
            if not sensor.adjusting and sensor.model.generation == "first":
                return "04", []  # the others tell their time at any time
            return "00", [with_sum(encode_number(sensor.clock.ms(now), 4))]
        if sensor.adjusting == (parameters == "0"):
            return "02" if sensor.adjusting else "03", []
        if sensor.streaming and sensor.model.generation != "first":
            return "10", []
        sensor.darken()
        sensor.adjusting = parameters == "0"
        return "00", []

    def _set_baud(self, parameters: str) -> str:
        if len(parameters) < 6:
            return "0C"
        if not (parameters.isascii() and parameters.isdigit()):
            return "01"
        if int(parameters) not in BAUDS:
            return "02"
        if self._sensor.baud is None:
            return "04"
        if self._sensor.baud == int(parameters):
            return "03"
        self._sensor.baud = int(parameters)
        return "00"

    def _turn_at(self, parameters: str, now: float) -> str:
        if len(parameters) != 2 or not (parameters.isascii() and parameters.isdigit()):
            return "01"
        level = 0 if parameters == "99" else int(parameters)
        if level > SLOWEST:
            return "02"
        if level == self._sensor.level:
            return "03"
        self._sensor.turn_at(level, now)
        return "00"

    def _set_sensitive(self, parameters: str) -> str:
        if parameters not in ("0", "1"):
            return "01"
        if self._sensor.sensitive == (parameters == "1"):
            return "02"
        self._sensor.sensitive = parameters == "1"
        return "00"

    def _simulate(self, parameters: str) -> str:
        """DB: what a host does about a sensor in trouble can be tried."""
        if parameters not in _SIMULATED:
            return "01"
        if parameters == "02":
            self._sensor.fail("50")
        elif parameters == "10":
            self._sensor.trouble = None
        self._sensor.coming.extend(_SIMULATED[parameters])
        return "00"
