"""One CARMEN log as the drivers see it: raw, or with corrected poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from cairn import from_ns
from cairn.components.replay.carmen_lines import LaserLine, OdometryLine, read_log
from cairn.components.replay.carmen_poses import chained, corrected, signed
from cairn.components.replay.recording import (
    Images,
    Odometry,
    RecordingError,
    Scans,
    Sightings,
    Source,
    Trajectory,
    from_deviations,
    nanoseconds,
)
from cairn.components.replay.text_lines import damaged
from cairn.components.replay.wheel_odometry import agree, deviations, velocities
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.message import InvalidMessage
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

Line = TypeVar("Line", OdometryLine, LaserLine)

_KINDS = ("FLASER", "ROBOTLASER1", "RAWLASER1")  # the first that a log holds is replayed
# A SICK LMS tells by codes of centimeters why it measured nothing: 8183 that all was beyond its
# reach, 8186 to 8191 an error such as dazzling or a signal too weak: at edges of things, too. [m]
_SICK_LONGEST, _SICK_ERRORS = 81.83, 81.855
_SHORTEST = 0.02  # [m]; zero is what some lasers tell where they measured nothing
_JITTER_S = 1.0  # how far lines may stand out of the order of time
_LONGEST_GAP_S = 3600.0


class CarmenRecording:
    """The log at `path`: wheel odometry, one front laser, and corrected poses if it has them.

    Scans, and their corrected poses, get a time `scan_delay_s` [s] before the one in the log.
    """

    def __init__(self, path: Path, scan_delay_s: float = 0.0) -> None:
        """Read it all; raises `RecordingError`."""
        self._path = path
        self._log = read_log(path)
        kinds = [kind for kind in _KINDS if kind in self._log.lasers]
        lasers = self._log.lasers[kinds[0]] if kinds else []
        self._kind = kinds[0] if kinds else ""
        wheels = chained(self._log.odometry, lasers)
        self._lasers = _in_order(path, lasers)
        times = np.array([line.time for line in self._lasers])
        self._laser_stamps = nanoseconds(np.maximum(times - scan_delay_s, 0.0))
        odometry = _in_order(path, wheels.lines)
        self._corrected = corrected(odometry, self._lasers)
        self._notes: list[str] = []
        if len(kinds) > 1:
            self._notes.append(f"{kinds[0]} is replayed, not {' or '.join(kinds[1:])} beside it")
        left_out = sorted(kind for kind in self._log.others if "LASER" in kind)
        if left_out:
            self._notes.append(f"{' and '.join(left_out)} are left out: not of the front laser")
        if wheels.anchors:
            self._notes.append(
                f"odometry was set to the corrected pose {wheels.anchors} times: put together "
                "again from its increments"
            )
        if lasers and lasers[0].beams.assumed:
            self._notes.append(
                f"{lasers[0].ranges.size} beams are not those of a SICK laser: taken as spread "
                "evenly over 180 degrees"
            )
        driven = signed(odometry)
        if driven.wrong_m:
            self._notes.append(
                f"odometry counted {driven.wrong_m:.1f} m of driving backwards as ahead: put right "
                "by the sign of the velocities beside it"
            )
        self._odometry = self._from_wheels(driven.lines)

    def span(self) -> tuple[int, int]:
        """Times [ns] of the first and the last scan or odometry."""
        odometry = self._odometry.stamps if self._odometry else ()
        ends = [*odometry[:1], *odometry[-1:], *self._laser_stamps[:1], *self._laser_stamps[-1:]]
        return min(ends), max(ends)

    def odometry(self) -> Odometry | None:
        """Poses of ODOM lines; in a raw log without these, the robot's poses at its scans."""
        return self._odometry

    def scans(self) -> Scans | None:
        """The front laser's scans; +inf where nothing was within reach, NaN where it failed."""
        if not self._lasers:
            return None
        pairs = zip(self._laser_stamps, self._lasers, strict=True)
        return Scans(self._laser_stamps, [self._scan(stamp, line) for stamp, line in pairs])

    def sightings(self) -> Sightings | None:
        """None: CARMEN logs have none."""
        return None

    def images(self) -> Images | None:
        """None: a log of laser and wheels holds none."""
        return None

    def truth(self) -> Trajectory | None:
        """A simulator's true poses, or the robot's corrected poses at its scans."""
        if self._log.true_poses:
            times = np.array([true.time for true in self._log.true_poses])
            return Trajectory(nanoseconds(times), np.array([t.pose for t in self._log.true_poses]))
        if self._corrected is None:
            return None
        return Trajectory(self._laser_stamps, self._corrected)

    def surveyed(self) -> VisualMap | None:
        """None: CARMEN logs have no landmarks."""
        return None

    def sources(self) -> Sequence[Source]:
        """The kinds of the log's lines."""
        log = self._log
        found = (
            [Source("odom", "ODOM", "wheel odometry", len(log.odometry))] if log.odometry else []
        )
        if self._odometry is not None and not found:
            found = [Source("odom", self._kind, "robot's pose", len(self._lasers))]
        for kind, lines in log.lasers.items():
            replayed = "scan" if kind == self._kind else None
            found.append(Source(replayed, kind, "laser scan", len(lines)))
        if log.true_poses:
            found.append(Source("truth", "TRUEPOS", "simulator's pose", len(log.true_poses)))
        elif self._corrected is not None:
            found.append(Source("truth", self._kind, "corrected pose", len(self._lasers)))
        return [*found, *(Source(None, kind, "", n) for kind, n in sorted(log.others.items()))]

    def notes(self) -> Sequence[str]:
        """What was assumed or left out."""
        return self._notes

    def posed_scans(self) -> Iterator[tuple[Pose, LaserScan]]:
        """The laser's own corrected pose at each scan, and the scan."""
        if self._corrected is None:
            raise RecordingError(
                f"{self._path} holds no corrected poses: those of its scans are raw odometry, "
                "or there are none. Give a log that a SLAM program has corrected, such as that of "
                "CARMEN's vasco or GMapping: no map is drawn of uncorrected odometry here."
            )
        for stamp, line in zip(self._laser_stamps, self._lasers, strict=True):
            assert line.laser is not None  # else nothing was found corrected
            yield line.laser, self._scan(stamp, line)

    def _from_wheels(self, lines: list[OdometryLine]) -> Odometry | None:
        """The odometry, its velocities as recorded if they can be right."""
        twists = np.array([(line.forward, line.turn) for line in lines])
        poses = np.array([line.pose for line in lines])
        times = np.array([line.time for line in lines])
        if not lines:
            if self._corrected is not None or not self._lasers or self._lasers[0].robot is None:
                return None
            poses = np.array([line.robot for line in self._lasers])
            times = np.array([line.time for line in self._lasers])
        stamps = nanoseconds(times)
        if not lines or not agree(stamps, poses, twists):
            twists = velocities(stamps, poses)
            self._notes.append("velocities are taken from the poses: none are recorded that fit")
        return Odometry(stamps, poses, from_deviations(deviations(poses)), twists)

    def _scan(self, stamp: int, line: LaserLine) -> LaserScan:
        longest = line.beams.longest
        if longest is None:
            told = self._log.parameters.get("robot_front_laser_max", "")
            longest = _as_length(told) or _SICK_LONGEST
        ranges = np.where(line.ranges >= longest, np.float32(math.inf), line.ranges)
        if longest <= _SICK_ERRORS:
            ranges[line.ranges > _SICK_ERRORS] = math.nan
        try:
            return LaserScan(
                header=Header(stamp=from_ns(stamp), frame_id="laser"),
                angle_min=line.beams.first,
                angle_max=line.beams.first + (ranges.size - 1) * line.beams.step,
                angle_increment=line.beams.step,
                range_min=_SHORTEST,
                range_max=longest,
                ranges=ranges,
            )
        except InvalidMessage as error:
            raise damaged(self._path, line.line, str(error)) from error


def posed_scans(path: Path) -> Iterator[tuple[Pose, LaserScan]]:
    """The scans of a corrected CARMEN log, each with the pose of the laser itself in the map.

    Whoever maps by them takes the scanner to sit at the robot's origin. Raises `RecordingError`
    for a log that is damaged or not corrected.
    """
    return CarmenRecording(path).posed_scans()


def _in_order(path: Path, lines: list[Line]) -> list[Line]:
    """Lines by their times; raises `RecordingError` where these cannot be right."""
    latest = lines[0].time if lines else 0.0
    for line in lines:
        if line.time < 0:
            raise damaged(path, line.line, f"time is {line.time:.3f} s")
        if line.time < latest - _JITTER_S:
            raise damaged(
                path,
                line.line,
                f"time runs backwards, from {latest:.3f} s to {line.time:.3f} s",
            )
        if line.time > latest + _LONGEST_GAP_S:
            after_s = line.time - latest
            raise damaged(path, line.line, f"{after_s:.0f} s pass since the record before")
        latest = max(latest, line.time)
    return sorted(lines, key=lambda line: line.time)


def _as_length(text: str) -> float | None:
    """A parameter as a length [m], None if it is none."""
    try:
        length = float(text)
    except ValueError:
        return None
    return length if math.isfinite(length) and length > 0 else None
