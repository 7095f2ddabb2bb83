"""The emulated sensor behind its protocol: mirror, laser, clock, and the room that it measures."""

from __future__ import annotations

import json
import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo_scanner.emulator_models import ScipModel, field_line, model_line
from cairn.components.hokuyo_scanner.protocol import NO_ECHO, encode_number

ECHOES = 3
"""The most echoes of one beam."""

Values = NDArray[np.int32]

CLOCK_MS = 1 << 24
"""The sensor's clock counts up to this [ms], in 4 h 39 min 37 s, and starts again at 0."""

_ETHERNET_LINE = "Ethernet 100 [Mbps]"

SLOWEST = 10
"""The highest level of CR; each takes one hundredth off the mirror's speed."""


class EmulatedSensor:
    """Mirror, laser and clock of the sensor; commands change it. Time [s] is passed."""

    def __init__(
        self,
        model: ScipModel,
        scene: EmulatedScene,
        *,
        baud: int | None,
        clock_start_ms: float,
        drift_ppm: float,
        sums_arrows: bool,
    ) -> None:
        self.model = model
        self.scene = scene
        self.defect: str | None = None
        """The status of its defect."""
        self.next_statuses: deque[str] = deque()
        """Statuses to send instead of a stream's next scans."""
        self._initial_baud = baud
        self.deaf_until = -math.inf
        self._clock_start_ms = clock_start_ms
        self._drift_ppm = drift_ppm
        self.sums_arrows = sums_arrows
        """Whether what follows `<-` in a line of II is part of its check sum."""
        self.reset(0.0)

    def powered_on(self, now: float) -> None:
        """Start as after power-on."""
        self.defect = None
        self.next_statuses.clear()
        self.deaf_until = -math.inf
        self.reset(now)

    def reset(self, now: float, *, keep_speeds: bool = False) -> None:
        """Reset: laser off, clock at its start; mirror and line as after power-on."""
        self.laser = False
        self.streaming = False
        self.adjusting = False
        self.asleep = False
        self.sensitive = False
        self.clock = SensorClock(now, self._clock_start_ms, self._drift_ppm)
        self._first_turn = 0
        if not keep_speeds:
            self.baud = self._initial_baud
            self.level = 0
            self.mirror = Mirror(self.model, now, self.model.turn_s)

    def laser_on(self, now: float) -> None:
        """Switch the laser on; leave sleep mode if the sensor is in it."""
        if not self.laser:
            self._first_turn = self.mirror.next(now)
        self.laser, self.asleep = True, False

    def laser_off(self) -> None:
        """Switch the laser off; a stream ends."""
        self.laser = self.streaming = False

    def fail(self, status: str) -> None:
        """Have a defect with this status, and stop."""
        self.defect = status
        self.laser_off()

    def set_level(self, level: int, now: float) -> None:
        """Reduce the mirror's speed by `level` hundredths."""
        self.level = level
        slower = 1.0 - 0.01 * level
        self.mirror = Mirror(self.model, now, self.model.turn_s / slower)
        self._first_turn = 0

    def newest_turn(self, now: float) -> int:
        """Return the last turn measured; the first to be measured if the laser is just on."""
        return max(self.mirror.newest(now), self._first_turn)

    def scan(self, turn: int, command: MeasureCommand) -> SentScan:
        """Return the requested part of what a turn has measured."""
        began = self.mirror.began(turn)
        measured = self.scene.turn(turn, began - self.clock.zero_s)
        distances, intensities = command.select(measured, self.model)
        return SentScan(
            command,
            turn,
            self.clock.ms(began),
            distances,
            intensities if command.intensity else None,
        )

    def state_number(self) -> str:
        """Return what %ST reports."""
        if self.defect is not None:
            return "900"
        if self.adjusting:
            return "002"
        if self.asleep:
            return "005"
        if self.streaming:
            return "004"
        return "003" if self.laser else "000"


def state_lines(sensor: EmulatedSensor, now: float) -> list[bytes]:
    """Return the lines of II, in the words of each generation of sensors."""
    describe = {"first": _first, "EW": _ew, "UST": _ust}[sensor.model.generation]
    rpm = round(60.0 / sensor.mirror.turn_s)
    speed, measures, line, time, status = describe(sensor, rpm, sensor.clock.ms(now))
    return [
        model_line(sensor.model),
        field_line("LASR", "ON" if sensor.laser else "OFF"),
        field_line("SCSP", speed, sums_arrow=sensor.sums_arrows),
        field_line("MESM", measures),
        field_line("SBPS", line, sums_arrow=sensor.sums_arrows),
        field_line("TIME", time),
        field_line("STAT", status),
    ]


def _first(sensor: EmulatedSensor, rpm: int, time_ms: int) -> tuple[str, str, str, str, str]:
    default = "<-Default setting by user"
    speed = f"Initial({rpm}[rpm]){default}"
    if sensor.level:
        speed = f"{sensor.level:02d}%down({rpm}[rpm])"
    mode = "Sensitive" if sensor.sensitive else "Normal"
    line = "USB only" if sensor.baud is None else f"{sensor.baud}[bps]{default}"
    defect = sensor.defect
    return (
        speed,
        f"Measuring by {mode} Mode" if sensor.laser else "IDLE",
        line,
        f"{time_ms:06X}",
        "Sensor works well." if defect is None else f"Sensor malfunction No.{defect}",
    )


def _ew(sensor: EmulatedSensor, rpm: int, time_ms: int) -> tuple[str, str, str, str, str]:
    measures = "000 Idle"
    if sensor.laser:
        measures = "004 Multi_scan" if sensor.streaming else "003 Single_scan"
    defect = sensor.defect
    return (
        str(rpm),
        measures,
        _ETHERNET_LINE,
        f"{time_ms:06x}",
        "Stable 000 no error." if defect is None else f"Error {defect:0>3}",
    )


def _ust(sensor: EmulatedSensor, rpm: int, time_ms: int) -> tuple[str, str, str, str, str]:
    defect = sensor.defect
    return (
        str(rpm),
        "Measuring by Sensitive Mode",
        _ETHERNET_LINE,
        encode_number(time_ms, 4).decode(),
        "sensor is working normally" if defect is None else f"abnormal {defect}",
    )


@dataclass(frozen=True)
class SensorClock:
    """Counts milliseconds from `start_ms` since `zero_s`, too fast by `drift_ppm` [1e-6]."""

    zero_s: float
    start_ms: float = 0.0
    drift_ppm: float = 0.0

    def ms(self, at_s: float) -> int:
        """Return what it shows at that time [s]."""
        passed = (at_s - self.zero_s) * 1000.0 * (1.0 + 1e-6 * self.drift_ppm)
        return math.floor(self.start_ms + passed) % CLOCK_MS


@dataclass(frozen=True)
class Mirror:
    """Turns evenly: turn 0 began, at step 0, at `began_s`; each takes `turn_s` [s]."""

    model: ScipModel
    began_s: float
    turn_s: float

    def began(self, turn: int) -> float:
        """Return when a turn passes step 0 [s]."""
        return self.began_s + turn * self.turn_s

    def measured(self, turn: int) -> float:
        """Return when the last step of a turn is measured [s]."""
        return self.began(turn) + self.turn_s * self.model.steps / self.model.turn_steps

    def newest(self, now: float) -> int:
        """Return the last turn whose measurement is complete by then."""
        return math.floor((now - self.measured(0)) / self.turn_s + 1e-6)

    def next(self, now: float) -> int:
        """Return the first turn that begins then or later."""
        return math.ceil((now - self.began_s) / self.turn_s - 1e-6)


@dataclass(frozen=True)
class MeasureCommand:
    """A command of the families G, H, M, N: which steps, in which clusters, how often."""

    letters: str
    first: int
    last: int
    cluster: int
    interval: int = 0
    scans: int = 0
    """How many; 0: without end, or one for a single scan."""

    @property
    def is_stream(self) -> bool:
        """Whether scans are sent as they are measured."""
        return self.letters[0] in "MN"

    @property
    def multi_echo(self) -> bool:
        """Whether all echoes of a step are requested."""
        return self.letters[0] in "HN"

    @property
    def intensity(self) -> bool:
        """Whether intensities are requested."""
        return self.letters[1] == "E"

    @property
    def width(self) -> int:
        """Characters of a number."""
        return 2 if self.letters[1] == "S" else 3

    def select(self, turn: TurnValues, model: ScipModel) -> tuple[Values, Values]:
        """Return the requested part of what a turn has measured: distances, intensities.

        A cluster gives the step with the smallest distance, among the valid ones.
        """
        distances = turn.distances[self.first : self.last + 1]
        intensities = turn.intensities[self.first : self.last + 1]
        if self.cluster == 1:
            return distances, intensities
        nearest = distances[:, 0]
        ranked = np.where(nearest >= model.least_mm, nearest, np.iinfo(np.int32).max)
        groups = -(-ranked.size // self.cluster)
        padded = np.full(groups * self.cluster, np.iinfo(np.int32).max, np.int64)
        padded[: ranked.size] = ranked
        chosen = padded.reshape(groups, self.cluster).argmin(axis=1)
        at = chosen + self.cluster * np.arange(groups)
        return distances[at], intensities[at]


@dataclass(frozen=True)
class SentScan:
    """A scan as it was sent, before any fault of the line.

    `time_ms`: the sensor's clock at step 0 [ms]. `distances` [mm or code] and `intensities` (where
    they were requested): shape (values, 3), `NO_ECHO` for a missing echo; without `multi_echo`
    the first column alone was sent. Two characters encode at most 4095 mm.
    """

    command: MeasureCommand
    turn: int
    time_ms: int
    distances: Values
    intensities: Values | None

    def line(self) -> str:
        """Return a line of JSON: a number for each value, or all its echoes if requested."""
        return json.dumps(
            {
                "command": self.command.letters,
                "first": self.command.first,
                "last": self.command.last,
                "cluster": self.command.cluster,
                "turn": self.turn,
                "time_ms": self.time_ms,
                "distances": self._shown(self.distances),
                "intensities": None if self.intensities is None else self._shown(self.intensities),
            },
            separators=(",", ":"),
        )

    def _shown(self, values: Values) -> list[int] | list[list[int]]:
        if not self.command.multi_echo:
            first: list[int] = values[:, 0].tolist()
            return first
        return [[one for one in row if one != NO_ECHO] for row in values.tolist()]


@dataclass(frozen=True)
class TurnValues:
    """What one turn of the mirror measures: values as they are sent, of all steps from 0 on.

    `distances` [mm, or a code of what failed] and `intensities` [no unit]: shape (steps, `ECHOES`),
    `NO_ECHO` for a missing echo; the first echo of a step always exists.
    """

    distances: Values
    intensities: Values


class EmulatedScene(Protocol):
    """The surroundings of an emulated scanner."""

    def turn(self, number: int, began_s: float) -> TurnValues:
        """Return what turn `number` measures, which began at that time [s]."""
        ...


class EmulatedRoom:
    """A room of 6 by 4 m with two pillars, a curtain that lets half the light through, a person.

    No two scans are equal: the walker moves, and every value has noise, which depends on the seed
    and the turn's number alone.
    """

    _NOISE_MM = 6.0
    _CURTAIN_MM = 1500.0  # its distance, from 60 to 80 degrees to the left
    _WALKER_MM = 200.0  # its radius; it walks on a circle about the scanner

    def __init__(self, model: ScipModel, seed: int = 0) -> None:
        self._model = model
        self._seed = seed
        steps = np.arange(model.steps)
        self._angles = 2.0 * math.pi * (steps - model.front) / model.turn_steps
        self._walls = np.minimum(
            _box(self._angles, ahead=4000.0, behind=2000.0, left=2200.0, right=1800.0),
            np.minimum(
                _disc(self._angles, 2500.0, -0.5, 250.0), _disc(self._angles, 1900.0, 1.7, 150.0)
            ),
        )
        degrees = np.degrees(self._angles)
        self._curtain = (degrees > 60.0) & (degrees < 80.0)
        self._opening = (degrees > -20.0) & (degrees < -15.0)  # a door: nothing comes back
        self._close = (degrees > -95.0) & (degrees < -93.0)  # a bar right before it

    def turn(self, number: int, began_s: float) -> TurnValues:
        """Return what this turn measures."""
        model = self._model
        random = np.random.default_rng((self._seed, number))
        walker = _disc(self._angles, 1200.0, 0.8 * began_s, self._WALKER_MM)
        hard = np.minimum(self._walls, walker)
        behind = self._curtain & (hard > self._CURTAIN_MM)
        found = np.full((model.steps, ECHOES), np.inf)
        found[:, 0] = np.where(behind, self._CURTAIN_MM, hard)
        found[behind, 1] = hard[behind]
        third = behind & (np.arange(model.steps) % 3 == 0)
        found[third, 2] = hard[third] + 400.0
        found += random.normal(0.0, self._NOISE_MM, found.shape)
        strength = 3.0e6 / np.maximum(found, 300.0) * (0.9 + 0.2 * random.random(found.shape))
        distances = np.where(np.isfinite(found), found, 0.0).astype(np.int32)
        intensities = strength.astype(np.int32)
        absent = ~np.isfinite(found) | (found > model.sight_mm)
        absent[self._opening] = True
        distances[absent], intensities[absent] = NO_ECHO, NO_ECHO
        near = self._close | ((distances[:, 0] != NO_ECHO) & (distances[:, 0] < model.least_mm))
        for code, where in ((model.nothing, absent[:, 0]), (model.near, near)):
            distances[where] = NO_ECHO
            intensities[where] = NO_ECHO
            distances[where, 0] = code
            intensities[where, 0] = 0
        return TurnValues(distances, intensities)


def _box(
    angles: NDArray[np.float64], *, ahead: float, behind: float, left: float, right: float
) -> NDArray[np.float64]:
    """Return the distance of a rectangle's sides from a point within."""
    across, along = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        return np.minimum(
            np.where(across > 0, ahead, behind) / np.abs(across),
            np.where(along > 0, left, right) / np.abs(along),
        )


def _disc(
    angles: NDArray[np.float64], distance: float, bearing: float, radius: float
) -> NDArray[np.float64]:
    """Return the distance of a disc's near side; infinite where the beam passes it."""
    beside = angles - bearing
    within = (np.abs(distance * np.sin(beside)) < radius) & (np.cos(beside) > 0)
    depth = np.sqrt(np.where(within, radius**2 - (distance * np.sin(beside)) ** 2, 0.0))
    return np.where(within, distance * np.cos(beside) - depth, np.inf)
