"""MRCLAM data sets: commanded velocities, landmark observations and motion capture of a robot.

Format: K. Leung et al., "The UTIAS multi-robot cooperative localization and mapping dataset", IJRR
30(8), 2011. Columns are separated by blanks, `#` starts a comment, times are seconds. Any of the
nine sets, any robot, plain or gzipped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay_devices.bounded_streams import text_lines
from cairn.components.replay_devices.record_times import TimeQuality, time_quality
from cairn.components.replay_devices.recording import (
    ObservationStream,
    OdometryStream,
    RecordedObservation,
    RecordedTopic,
    Recording,
    TimedPoses,
    covariances_of,
    damaged_line,
    nanoseconds,
)
from cairn.errors import RecordingError
from cairn.schemas.cairn_msgs import VisualMap, VisualObject
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]


class MrclamRecording(Recording):
    """Commanded velocities, observations and motion-capture poses of `robot` in `folder`."""

    def __init__(self, folder: Path, robot: int) -> None:
        self._folder = folder
        self._dataset = MrclamDataset(folder)
        self._robot = robot

    def span(self) -> tuple[int, int]:
        """Return the times [ns] of the first and the last odometry or observation."""
        first, last = nanoseconds(np.array(self._dataset.span(self._robot)))
        return first, last

    def odometry(self) -> OdometryStream:
        """Return the commanded velocities, and the poses that they add up to."""
        rows = self._dataset.odometry(self._robot)
        poses, deviations = integrate_commands(rows)
        covariances = covariances_of(deviations)
        return OdometryStream(nanoseconds(rows[:, 0]), poses, covariances, rows[:, 1:])

    def observations(self) -> ObservationStream:
        """Return the observations of landmarks, those of one time as one frame.

        The id of a landmark is its subject number. Observations of other robots are left out.
        """
        subjects = self._dataset.subjects()
        table = self._dataset.observations(self._robot)
        stamps: list[int] = []
        frames: list[list[RecordedObservation]] = []
        records = zip(table.barcode, table.range_m, table.bearing, strict=True)
        for stamp, record in zip(nanoseconds(table.time), records, strict=True):
            if not stamps or stamp != stamps[-1]:
                stamps.append(stamp)
                frames.append([])
            barcode, range_m, bearing = int(record[0]), float(record[1]), float(record[2])
            subject = subjects.get(barcode)
            if subject not in ROBOTS:
                variances = range_bearing_variance(range_m)
                frames[-1].append(
                    RecordedObservation(barcode, subject, range_m, bearing, *variances)
                )
        return ObservationStream(stamps, frames)

    def truth(self) -> TimedPoses:
        """Return the motion-capture poses."""
        rows = self._dataset.truth(self._robot)
        return TimedPoses(nanoseconds(rows[:, 0]), rows[:, 1:])

    def landmark_map(self) -> VisualMap:
        """Return the surveyed landmarks."""
        return read_landmarks(self._folder)

    def topics(self) -> Sequence[RecordedTopic]:
        """Return the robot's three files."""
        data, robot = self._dataset, self._robot
        return [
            RecordedTopic("odom", f"Robot{robot}_Odometry", "commands", len(data.odometry(robot))),
            RecordedTopic("objects", f"Robot{robot}_Measurement", "observations",
                   data.observations(robot).time.size),
            RecordedTopic("truth", f"Robot{robot}_Groundtruth", "motion capture",
                          len(data.truth(robot))),
        ]  # fmt: skip

    def time_quality(self) -> Mapping[str, TimeQuality]:
        """Return the quality of the times in the robot's three files."""
        data = self._dataset
        times = {
            "odom": data.odometry(self._robot)[:, 0],
            "objects": np.unique(data.observations(self._robot).time),
            "truth": data.truth(self._robot)[:, 0],
        }
        return {kind: time_quality(nanoseconds(of)) for kind, of in times.items()}


def read_landmarks(folder: Path) -> VisualMap:
    """Return the surveyed map of the data set in `folder`; objects are numbered by subject.

    Raises `RecordingError` for a file that is missing or damaged.
    """
    return VisualMap(
        header=Header(frame_id="map"),
        objects=tuple(MrclamDataset(folder).landmarks()),
    )


def range_bearing_variance(range_m: float) -> tuple[float, float]:
    """Return the variances [m^2, rad^2] of an observation at `range_m` [m].

    Measured against the data set's motion capture: the range error grows in proportion to the
    range, the bearing error is 0.8 degrees plus a sideways error of 4 cm of the barcode's center.
    """
    range_sd = 0.05 + 0.035 * range_m
    sideways = 0.04 / max(range_m, 0.3)
    return range_sd**2, math.radians(0.8) ** 2 + sideways**2


def integrate_commands(odometry: Array) -> tuple[Array, Array]:
    """Return poses (n, 3: m, m, rad) and their standard deviations (n, 2: m, rad) at records.

    These are (n, 3): time [s], forward [m/s], turn [rad/s]. A command holds until the next one. The
    deviations assume that the base executes a command with an error of 10 % and drifts by 0.04 rad
    and 2.5 cm per square root of a second of motion.
    """
    time, forward, turn = odometry.T
    step = np.diff(time)
    turned = turn[:-1] * step
    advanced = forward[:-1] * step
    theta = np.concatenate([[0.0], np.cumsum(turned)])
    middle = theta[:-1] + 0.5 * turned
    x = np.concatenate([[0.0], np.cumsum(advanced * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(advanced * np.sin(middle))])

    moving = np.concatenate([[0.0], np.cumsum(step * ((advanced != 0) | (turned != 0)))])
    path = np.concatenate([[0.0], np.cumsum(np.abs(advanced))])
    turn_sd = np.sqrt(0.04**2 * moving + (0.1 * np.abs(theta)) ** 2)
    position_sd = np.sqrt(0.025**2 * moving + (0.1 * path) ** 2 + (0.5 * turn_sd * path) ** 2)
    return np.stack([x, y, theta], axis=1), np.stack([position_sd, turn_sd], axis=1)


ROBOTS = range(1, 6)  # subjects 1..5 are robots, 6..20 landmarks
_LONGEST_GAP_S = 3600.0


@dataclass(frozen=True)
class _Column:
    """A column of a file: its meaning, and the limits outside which a number is damaged."""

    name: str
    low: float
    high: float


_TIME = _Column("time [s]", 0.0, 2.0**31)
_SUBJECT = _Column("subject", 0.0, 1e6)
_BARCODE = _Column("barcode", 0.0, 1e6)
_POSITION = (_Column("x [m]", -1e5, 1e5), _Column("y [m]", -1e5, 1e5))
_DEVIATIONS = (_Column("standard deviation of x [m]", 0.0, 1e3),
               _Column("standard deviation of y [m]", 0.0, 1e3))  # fmt: skip
_VELOCITIES = (_Column("forward [m/s]", -100.0, 100.0), _Column("turn [rad/s]", -100.0, 100.0))
_OBSERVATION = (_BARCODE, _Column("range [m]", 1e-6, 1e4), _Column("bearing [rad]", -7.0, 7.0))
_HEADING = _Column("heading [rad]", -1e3, 1e3)


@dataclass(frozen=True)
class ObservationTable:
    """Observations of the camera: time [s], barcode, range [m], bearing [rad, left positive]."""

    time: Array
    barcode: NDArray[np.int64]
    range_m: Array
    bearing: Array


@dataclass(frozen=True)
class MrclamDataset:
    """The folder of one data set."""

    folder: Path

    def subjects(self) -> dict[int, int]:
        """Return the subject number of each barcode number."""
        path = self._find("Barcodes.dat")
        table, lines = _read(path, (_SUBJECT, _BARCODE))
        subjects: dict[int, int] = {}
        for (subject, barcode), line in zip(table, lines, strict=True):
            number = _whole(path, line, barcode, "barcode")
            if number in subjects:
                raise damaged_line(path, line, f"barcode {number} is listed twice")
            subjects[number] = _whole(path, line, subject, "subject")
        return subjects

    def landmarks(self) -> list[VisualObject]:
        """Return the surveyed landmarks, in the order of the file."""
        path = self._find("Landmark_Groundtruth.dat")
        table, lines = _read(path, (_SUBJECT, *_POSITION, *_DEVIATIONS))
        surveys: dict[int, VisualObject] = {}
        for (number, x, y, x_sd, y_sd), line in zip(table.tolist(), lines, strict=True):
            subject = _whole(path, line, number, "subject")
            if subject in surveys:
                raise damaged_line(path, line, f"landmark {subject} is listed twice")
            surveys[subject] = VisualObject(
                object_id=subject,
                name=f"landmark {subject}",
                x=x,
                y=y,
                covariance=np.array([x_sd**2, 0.0, 0.0, y_sd**2]),
                reliability=0.5,
                state=VisualObject.LIVE,
            )
        return list(surveys.values())

    def odometry(self, robot: int) -> Array:
        """Return commands (n, 3): time [s], forward [m/s], turn [rad/s, left positive]."""
        return self._series(f"Robot{robot}_Odometry.dat", _VELOCITIES)[0]

    def truth(self, robot: int) -> Array:
        """Return motion-capture poses (n, 4): time [s], x [m], y [m], heading [rad]."""
        return self._series(f"Robot{robot}_Groundtruth.dat", (*_POSITION, _HEADING))[0]

    def observations(self, robot: int) -> ObservationTable:
        """Return all observations of the camera, robots and unknown barcodes included."""
        name = f"Robot{robot}_Measurement.dat"
        table, lines = self._series(name, _OBSERVATION)
        for line, barcode in zip(lines, table[:, 1], strict=True):
            _whole(self._find(name), line, barcode, "barcode")
        return ObservationTable(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3])

    def span(self, robot: int) -> tuple[float, float]:
        """Return the times [s] of the first and the last record that a replay publishes."""
        odometry = self.odometry(robot)
        observations = self.observations(robot)
        apart_s = observations.time[0] - odometry[0, 0]
        if abs(apart_s) > _LONGEST_GAP_S:
            raise RecordingError(
                f"{self.folder}: the first observation of robot {robot} is {apart_s:.0f} s from "
                "its first odometry, so the files are not from one run. Take a fresh copy of the "
                "data set."
            )
        times = [odometry[0, 0], odometry[-1, 0], *observations.time[:1], *observations.time[-1:]]
        return float(min(times)), float(max(times))

    def _series(self, name: str, columns: tuple[_Column, ...]) -> tuple[Array, list[int]]:
        """Return the records of a file in temporal order, and the line of each."""
        path = self._find(name)
        table, lines = _read(path, (_TIME, *columns))
        back = np.nonzero(np.diff(table[:, 0]) < 0)[0]
        if back.size:
            k = int(back[0])
            raise damaged_line(
                path,
                lines[k + 1],
                f"time runs backwards, from {table[k, 0]:.3f} s to {table[k + 1, 0]:.3f} s",
            )
        gap = np.nonzero(np.diff(table[:, 0]) > _LONGEST_GAP_S)[0]
        if gap.size:
            k = int(gap[0])
            after_s = table[k + 1, 0] - table[k, 0]
            raise damaged_line(
                path, lines[k + 1], f"{after_s:.0f} s pass since the record before it"
            )
        return table, lines

    def _find(self, name: str) -> Path:
        for path in (self.folder / name, self.folder / f"{name}.gz"):
            if path.is_file():
                return path
        if not self.folder.is_dir():
            raise RecordingError(
                f"{self.folder}: no such folder. Use the folder that holds Barcodes.dat, "
                "Landmark_Groundtruth.dat and the Robot<n>_*.dat files of one MRCLAM data set."
            )
        held = sorted(p.name for p in self.folder.glob("*.dat*"))
        raise RecordingError(
            f"{self.folder} holds neither {name} nor {name}.gz (it holds: "
            f"{', '.join(held) if held else 'no .dat file'}). Use another robot number or "
            "complete the data set."
        )


def _read(path: Path, columns: tuple[_Column, ...]) -> tuple[Array, list[int]]:
    """Read the numbers of a file (rows, columns) and the line number of each row."""
    records = {line: text for line, text in text_lines(path) if text.split("#", 1)[0].strip()}
    if not records:
        raise RecordingError(
            f"{path} holds no record. It is empty or cut off: take a fresh copy of the data set."
        )
    lines = list(records)
    table = _parse(list(records.values()))
    if table is None or table.shape[1] != len(columns) or not np.isfinite(table).all():
        # Line by line, which is slow, to find the damaged one.
        table = np.array([_parse_line(path, line, records[line], columns) for line in lines])
    for column, values in zip(columns, table.T, strict=True):
        wrong = np.nonzero((values < column.low) | (values > column.high))[0]
        if wrong.size:
            found = f"{column.name} is {values[wrong[0]]:g}"
            limits = f"not from {column.low:g} to {column.high:g}"
            raise damaged_line(path, lines[int(wrong[0])], f"{found}, {limits}")
    return table, lines


def _parse(records: list[str]) -> Array | None:
    """Return the numbers of all lines at once, None if a line is damaged."""
    try:
        return np.loadtxt(records, ndmin=2)
    except ValueError:
        return None


def _parse_line(path: Path, line: int, text: str, columns: tuple[_Column, ...]) -> list[float]:
    fields = text.split("#", 1)[0].split()
    if len(fields) != len(columns):
        found = f"{len(fields)} columns instead of {len(columns)}: {text.strip()[:60]!r}"
        raise damaged_line(path, line, found)
    try:
        row = [float(field) for field in fields]
    except ValueError:
        raise damaged_line(path, line, f"not a number in {text.strip()[:60]!r}") from None
    if not all(map(math.isfinite, row)):
        raise damaged_line(path, line, f"not a finite number in {text.strip()[:60]!r}")
    return row


def _whole(path: Path, line: int, value: float, meaning: str) -> int:
    if value % 1 != 0 or value < 0:
        raise damaged_line(path, line, f"{meaning} {value:g} is not a whole number")
    return int(value)
