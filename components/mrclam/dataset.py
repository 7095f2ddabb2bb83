"""Reading the folder of an MRCLAM data set: any of the nine sets, any robot, plain or gzipped.

Format: K. Leung et al., "The UTIAS multi-robot cooperative localization and mapping dataset",
IJRR 30(8), 2011. Columns are separated by blanks, `#` begins a comment, times are seconds.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError

Table = NDArray[np.float64]

ROBOTS = range(1, 6)  # subjects 1..5 are robots, 6..20 landmarks


class DatasetError(CairnError):
    """A data set that is missing, damaged or of another format."""


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
        table, lines = _read(path, 2)
        subjects: dict[int, int] = {}
        for (subject, barcode), line in zip(table, lines, strict=True):
            number = _whole(path, line, barcode, "barcode")
            if number in subjects:
                raise _damaged(path, line, f"barcode {number} is listed twice")
            subjects[number] = _whole(path, line, subject, "subject")
        return subjects

    def landmarks(self) -> list[Survey]:
        """The surveyed landmarks, in the file's order."""
        path = self._find("Landmark_Groundtruth.dat")
        table, lines = _read(path, 5)
        surveys: dict[int, Survey] = {}
        for row, line in zip(table, lines, strict=True):
            subject = _whole(path, line, row[0], "subject")
            if subject in surveys:
                raise _damaged(path, line, f"landmark {subject} is listed twice")
            surveys[subject] = Survey(subject, *(float(value) for value in row[1:]))
        return list(surveys.values())

    def odometry(self, robot: int) -> Table:
        """Commanded velocities (n, 3): time [s], forward [m/s], turn [rad/s, left positive]."""
        return self._series(f"Robot{robot}_Odometry.dat", 3)

    def truth(self, robot: int) -> Table:
        """Motion-capture poses (n, 4): time [s], x [m], y [m], heading [rad]."""
        return self._series(f"Robot{robot}_Groundtruth.dat", 4)

    def sightings(self, robot: int) -> Sightings:
        """What the robot's camera saw, robots and unknown barcodes included."""
        name = f"Robot{robot}_Measurement.dat"
        table = self._series(name, 4)
        wrong = np.nonzero((table[:, 1] % 1 != 0) | (table[:, 2] <= 0))[0]
        if wrong.size:
            row = table[wrong[0]]
            raise DatasetError(
                f"{self._find(name)}: the sighting at {row[0]:.3f} s has barcode {row[1]:g} and "
                f"range {row[2]:g} m; a barcode is a whole number and a range is positive. "
                "Take a fresh copy of the data set."
            )
        return Sightings(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3])

    def span(self, robot: int) -> tuple[float, float]:
        """Times [s] of the first and the last record that a replay of `robot` publishes."""
        odometry = self.odometry(robot)
        sightings = self.sightings(robot)
        times = [odometry[0, 0], odometry[-1, 0], *sightings.time[:1], *sightings.time[-1:]]
        return float(min(times)), float(max(times))

    def _series(self, name: str, columns: int) -> Table:
        path = self._find(name)
        table, lines = _read(path, columns)
        back = np.nonzero(np.diff(table[:, 0]) < 0)[0]
        if back.size:
            k = int(back[0])
            raise _damaged(
                path,
                lines[k + 1],
                f"time runs backwards, from {table[k, 0]:.3f} s to {table[k + 1, 0]:.3f} s",
            )
        return table

    def _find(self, name: str) -> Path:
        for path in (self.folder / name, self.folder / f"{name}.gz"):
            if path.is_file():
                return path
        if not self.folder.is_dir():
            raise DatasetError(
                f"{self.folder}: no such folder. Give the folder that holds Barcodes.dat, "
                "Landmark_Groundtruth.dat and the Robot<n>_*.dat files of one MRCLAM data set."
            )
        held = sorted(p.name for p in self.folder.glob("*.dat*"))
        raise DatasetError(
            f"{self.folder} holds neither {name} nor {name}.gz (it holds: "
            f"{', '.join(held) if held else 'no .dat file'}). Give another robot number or "
            "complete the data set."
        )


def _read(path: Path, columns: int) -> tuple[Table, list[int]]:
    """The numbers of a file (rows, columns) and the line number of each row."""
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, text in _lines(path):
        fields = text.split("#", 1)[0].split()
        if not fields:
            continue
        if len(fields) != columns:
            raise _damaged(
                path, line, f"{len(fields)} columns where {columns} belong: {text.strip()[:60]!r}"
            )
        try:
            row = [float(field) for field in fields]
        except ValueError:
            raise _damaged(path, line, f"not a number in {text.strip()[:60]!r}") from None
        if not all(map(math.isfinite, row)):
            raise _damaged(path, line, f"not a finite number in {text.strip()[:60]!r}")
        rows.append(row)
        lines.append(line)
    if not rows:
        raise DatasetError(
            f"{path} holds no record. It is empty or cut off: take a fresh copy of the data set."
        )
    return np.array(rows), lines


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    line = 0
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as stream:
            for line, raw in enumerate(stream, start=1):
                yield line, raw.decode("ascii")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise _damaged(path, line + 1, f"the gzip stream is broken ({error})") from error
    except UnicodeDecodeError as error:
        raise _damaged(path, line, "not a text file") from error
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror or error}.") from error


def _whole(path: Path, line: int, value: float, what: str) -> int:
    if value % 1 != 0 or value < 0:
        raise _damaged(path, line, f"{what} {value:g} is not a whole number")
    return int(value)


def _damaged(path: Path, line: int, what: str) -> DatasetError:
    return DatasetError(
        f"{path}, line {line}: {what}. The file is cut off, changed or of another format: "
        "take a fresh copy of the data set."
    )
