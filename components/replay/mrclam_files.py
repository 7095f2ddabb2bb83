"""Reading the folder of an MRCLAM data set: any of the nine sets, any robot, plain or gzipped.

Format: K. Leung et al., "The UTIAS multi-robot cooperative localization and mapping dataset",
IJRR 30(8), 2011. Columns are separated by blanks, `#` begins a comment, times are seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay.recording import RecordingError
from cairn.components.replay.text_lines import damaged, text_lines

Table = NDArray[np.float64]

ROBOTS = range(1, 6)  # subjects 1..5 are robots, 6..20 landmarks


_LONGEST_GAP_S = 3600.0


@dataclass(frozen=True)
class _Column:
    """A column of a file: its meaning, and the limits beyond which a number is damage."""

    name: str
    low: float
    high: float


_TIME = _Column("time [s]", 0.0, 2.0**31)
_SUBJECT = _Column("subject", 0.0, 1e6)
_BARCODE = _Column("barcode", 0.0, 1e6)
_PLACE = (_Column("x [m]", -1e5, 1e5), _Column("y [m]", -1e5, 1e5))
_DEVIATIONS = (_Column("standard deviation of x [m]", 0.0, 1e3),
               _Column("standard deviation of y [m]", 0.0, 1e3))  # fmt: skip
_VELOCITIES = (_Column("forward [m/s]", -100.0, 100.0), _Column("turn [rad/s]", -100.0, 100.0))
_SIGHTING = (_BARCODE, _Column("range [m]", 1e-6, 1e4), _Column("bearing [rad]", -7.0, 7.0))
_HEADING = _Column("heading [rad]", -1e3, 1e3)


@dataclass(frozen=True)
class Survey:
    """A landmark as surveyed: subject number, place [m] and its standard deviations [m]."""

    subject: int
    x: float
    y: float
    x_sd: float
    y_sd: float


@dataclass(frozen=True)
class Sightings:
    """Camera sightings: time [s], barcode number, range [m], bearing [rad, left positive]."""

    time: Table
    barcode: NDArray[np.int64]
    range_m: Table
    bearing: Table


@dataclass(frozen=True)
class Dataset:
    """The folder of one data set."""

    folder: Path

    def subjects(self) -> dict[int, int]:
        """Subject number of each barcode number."""
        path = self._find("Barcodes.dat")
        table, lines = _read(path, (_SUBJECT, _BARCODE))
        subjects: dict[int, int] = {}
        for (subject, barcode), line in zip(table, lines, strict=True):
            number = _whole(path, line, barcode, "barcode")
            if number in subjects:
                raise damaged(path, line, f"barcode {number} is listed twice")
            subjects[number] = _whole(path, line, subject, "subject")
        return subjects

    def landmarks(self) -> list[Survey]:
        """The surveyed landmarks, in the file's order."""
        path = self._find("Landmark_Groundtruth.dat")
        table, lines = _read(path, (_SUBJECT, *_PLACE, *_DEVIATIONS))
        surveys: dict[int, Survey] = {}
        for row, line in zip(table, lines, strict=True):
            subject = _whole(path, line, row[0], "subject")
            if subject in surveys:
                raise damaged(path, line, f"landmark {subject} is listed twice")
            surveys[subject] = Survey(subject, *(float(value) for value in row[1:]))
        return list(surveys.values())

    def odometry(self, robot: int) -> Table:
        """Commanded velocities (n, 3): time [s], forward [m/s], turn [rad/s, left positive]."""
        return self._series(f"Robot{robot}_Odometry.dat", _VELOCITIES)[0]

    def truth(self, robot: int) -> Table:
        """Motion-capture poses (n, 4): time [s], x [m], y [m], heading [rad]."""
        return self._series(f"Robot{robot}_Groundtruth.dat", (*_PLACE, _HEADING))[0]

    def sightings(self, robot: int) -> Sightings:
        """What the robot's camera saw, robots and unknown barcodes included."""
        name = f"Robot{robot}_Measurement.dat"
        table, lines = self._series(name, _SIGHTING)
        for line, barcode in zip(lines, table[:, 1], strict=True):
            _whole(self._find(name), line, barcode, "barcode")
        return Sightings(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3])

    def span(self, robot: int) -> tuple[float, float]:
        """Times [s] of the first and the last record that a replay of `robot` publishes."""
        odometry = self.odometry(robot)
        sightings = self.sightings(robot)
        apart_s = sightings.time[0] - odometry[0, 0]
        if abs(apart_s) > _LONGEST_GAP_S:
            raise RecordingError(
                f"{self.folder}: the first sighting of robot {robot} is {apart_s:.0f} s from its "
                "first odometry, so the files are not of one run. Take a fresh copy of the data "
                "set."
            )
        times = [odometry[0, 0], odometry[-1, 0], *sightings.time[:1], *sightings.time[-1:]]
        return float(min(times)), float(max(times))

    def _series(self, name: str, columns: tuple[_Column, ...]) -> tuple[Table, list[int]]:
        """The records of a file in order of time, and the line of each."""
        path = self._find(name)
        table, lines = _read(path, (_TIME, *columns))
        back = np.nonzero(np.diff(table[:, 0]) < 0)[0]
        if back.size:
            k = int(back[0])
            raise damaged(
                path,
                lines[k + 1],
                f"time runs backwards, from {table[k, 0]:.3f} s to {table[k + 1, 0]:.3f} s",
            )
        gap = np.nonzero(np.diff(table[:, 0]) > _LONGEST_GAP_S)[0]
        if gap.size:
            k = int(gap[0])
            after_s = table[k + 1, 0] - table[k, 0]
            raise damaged(path, lines[k + 1], f"{after_s:.0f} s pass since the record before")
        return table, lines

    def _find(self, name: str) -> Path:
        for path in (self.folder / name, self.folder / f"{name}.gz"):
            if path.is_file():
                return path
        if not self.folder.is_dir():
            raise RecordingError(
                f"{self.folder}: no such folder. Give the folder that holds Barcodes.dat, "
                "Landmark_Groundtruth.dat and the Robot<n>_*.dat files of one MRCLAM data set."
            )
        held = sorted(p.name for p in self.folder.glob("*.dat*"))
        raise RecordingError(
            f"{self.folder} holds neither {name} nor {name}.gz (it holds: "
            f"{', '.join(held) if held else 'no .dat file'}). Give another robot number or "
            "complete the data set."
        )


def _read(path: Path, columns: tuple[_Column, ...]) -> tuple[Table, list[int]]:
    """The numbers of a file (rows, columns) and the line number of each row."""
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, text in text_lines(path):
        fields = text.split("#", 1)[0].split()
        if not fields:
            continue
        if len(fields) != len(columns):
            found = f"{len(fields)} columns where {len(columns)} belong: {text.strip()[:60]!r}"
            raise damaged(path, line, found)
        try:
            row = [float(field) for field in fields]
        except ValueError:
            raise damaged(path, line, f"not a number in {text.strip()[:60]!r}") from None
        if not all(map(math.isfinite, row)):
            raise damaged(path, line, f"not a finite number in {text.strip()[:60]!r}")
        rows.append(row)
        lines.append(line)
    if not rows:
        raise RecordingError(
            f"{path} holds no record. It is empty or cut off: take a fresh copy of the data set."
        )
    table = np.array(rows)
    for column, values in zip(columns, table.T, strict=True):
        wrong = np.nonzero((values < column.low) | (values > column.high))[0]
        if wrong.size:
            found = f"{column.name} is {values[wrong[0]]:g}"
            limits = f"not from {column.low:g} to {column.high:g}"
            raise damaged(path, lines[int(wrong[0])], f"{found}, {limits}")
    return table, lines


def _whole(path: Path, line: int, value: float, what: str) -> int:
    if value % 1 != 0 or value < 0:
        raise damaged(path, line, f"{what} {value:g} is not a whole number")
    return int(value)
