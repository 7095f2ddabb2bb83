"""One robot's recording of an MRCLAM data set, as the drivers see it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cairn.components.replay.dead_reckoning import reckon
from cairn.components.replay.landmarks import read_landmarks
from cairn.components.replay.mrclam_files import ROBOTS, Dataset
from cairn.components.replay.recording import (
    Images,
    Odometry,
    Scans,
    Sighting,
    Sightings,
    Source,
    Trajectory,
    from_deviations,
    nanoseconds,
)
from cairn.components.replay.sighting_noise import range_bearing_variance
from cairn.schemas.cairn_msgs import VisualMap


class MrclamRecording:
    """Commanded velocities, sightings and motion-capture truth of `robot` in `folder`."""

    def __init__(self, folder: Path, robot: int) -> None:
        self._folder = folder
        self._dataset = Dataset(folder)
        self._robot = robot

    def span(self) -> tuple[int, int]:
        """Times [ns] of the first and the last odometry or sighting."""
        first, last = nanoseconds(np.array(self._dataset.span(self._robot)))
        return first, last

    def odometry(self) -> Odometry:
        """The commanded velocities, and the poses that they add up to from the first on."""
        rows = self._dataset.odometry(self._robot)
        reckoned = reckon(rows)
        covariances = from_deviations(reckoned.deviations)
        return Odometry(nanoseconds(rows[:, 0]), reckoned.poses, covariances, rows[:, 1:])

    def scans(self) -> Scans | None:
        """None: the robots had no laser scanner."""
        return None

    def sightings(self) -> Sightings:
        """Sightings of landmarks, those of one time as one frame; an id is the subject's number.

        Sightings of other robots are left out.
        """
        subjects = self._dataset.subjects()
        seen = self._dataset.sightings(self._robot)
        stamps: list[int] = []
        frames: list[list[Sighting]] = []
        records = zip(seen.barcode, seen.range_m, seen.bearing, strict=True)
        for stamp, record in zip(nanoseconds(seen.time), records, strict=True):
            if not stamps or stamp != stamps[-1]:
                stamps.append(stamp)
                frames.append([])
            barcode, range_m, bearing = int(record[0]), float(record[1]), float(record[2])
            subject = subjects.get(barcode)
            if subject not in ROBOTS:
                variances = range_bearing_variance(range_m)
                frames[-1].append(Sighting(barcode, subject, range_m, bearing, *variances))
        return Sightings(stamps, frames)

    def images(self) -> Images | None:
        """None: the data set tells what cameras made of their images."""
        return None

    def truth(self) -> Trajectory:
        """Motion-capture poses."""
        rows = self._dataset.truth(self._robot)
        return Trajectory(nanoseconds(rows[:, 0]), rows[:, 1:])

    def surveyed(self) -> VisualMap:
        """The landmarks as surveyed."""
        return read_landmarks(self._folder)

    def sources(self) -> Sequence[Source]:
        """The robot's three files."""
        data, robot = self._dataset, self._robot
        return [
            Source("odom", f"Robot{robot}_Odometry", "commands", len(data.odometry(robot))),
            Source("objects", f"Robot{robot}_Measurement", "sightings",
                   data.sightings(robot).time.size),
            Source("truth", f"Robot{robot}_Groundtruth", "motion capture", len(data.truth(robot))),
        ]  # fmt: skip

    def notes(self) -> Sequence[str]:
        """None: these files are read whole or refused."""
        return ()
