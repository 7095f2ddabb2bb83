"""Lines of a CARMEN log: their fields, and the records that are damaged.

Format: the log's own header, and `log_param.h`, `readlog.c` of the Carnegie Mellon Navigation
Toolkit. Every line ends in `ipc_timestamp ipc_hostname logger_timestamp`; the time of a record is
its `ipc_timestamp` [s], at which the message was sent.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.replay_devices.bounded_streams import text_lines
from cairn.components.replay_devices.record_times import NO_TIME
from cairn.components.replay_devices.recording import BAD_SHARE, FEW_BAD, damaged_line
from cairn.errors import RecordingError
from cairn.planar.poses import Pose

MESSAGES = ("PARAM", "SYNC", "ODOM", "FLASER", "RLASER", "TRUEPOS", "RAWLASER1", "ROBOTLASER1")
"""Names at the start of lines of a CARMEN log, among others."""

_MOST_LISTED = 1_000  # bad records of which the line is kept
_STAMP = 3  # the fields that end each line
_LATEST_S = 2**31  # programs that subtract too much write 4.29497e+09
_LARGEST = 1e9  # of ranges, poses and velocities: no robot goes so far

SHORTEST_M = 0.02
"""The shortest range [m]; some lasers report zero where they measured nothing."""


@dataclass(frozen=True, slots=True)
class OdometryLine:
    """Pose [m, m, rad] and velocities [m/s, rad/s] of the robot, from its wheels.

    `stamp` [ns] is when the message was sent, `logger_s` [s] when it was logged, NaN if unknown.
    """

    stamp: int
    pose: Pose
    forward: float
    turn: float
    line: int
    logger_s: float = math.nan

    @property
    def time(self) -> float:
        """When the message was sent [s]."""
        return self.stamp / SECOND


@dataclass(frozen=True, slots=True)
class LaserLine:
    """One scan: `ranges` [m] in `beams`, and the recorded poses of laser and robot.

    `stamp` [ns] is when the message was sent, `logger_s` [s] when it was logged, NaN if unknown.
    `velocity` is the robot's, forward [m/s] and turn [rad/s], None where the line has none.
    """

    stamp: int
    ranges: NDArray[np.float32]
    beams: BeamLayout
    laser: Pose | None
    robot: Pose | None
    line: int
    logger_s: float = math.nan
    velocity: tuple[float, float] | None = None

    @property
    def time(self) -> float:
        """When the message was sent [s]."""
        return self.stamp / SECOND


@dataclass(frozen=True)
class BeamLayout:
    """Direction of the first beam, angle between beams [rad], and the longest range [m].

    `longest` is None where the line does not hold it; `assumed` if the angles are a guess.
    """

    first: float
    step: float
    longest: float | None = None
    assumed: bool = False


@dataclass(frozen=True)
class TruePose:
    """The true pose of a simulated robot at `stamp` [ns]."""

    stamp: int
    pose: Pose
    line: int


@dataclass(frozen=True)
class BadRecord:
    """A record that cannot be used: its line and why."""

    line: int
    fault: str


@dataclass
class CarmenLog:
    """The records of a log in the order of its lines; other kinds are only counted.

    `bad` has the first of the records that cannot be used, `bad_count` is their number.
    """

    odometry: list[OdometryLine] = field(default_factory=list)
    lasers: dict[str, list[LaserLine]] = field(default_factory=dict)
    true_poses: list[TruePose] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)
    bad: list[BadRecord] = field(default_factory=list)
    bad_count: int = 0
    records: int = 0
    """Number of records of the kinds that are read, the bad ones included."""

    def reject(self, line: int, fault: str) -> None:
        """Count a bad record."""
        self.bad_count += 1
        if len(self.bad) < _MOST_LISTED:
            self.bad.append(BadRecord(line, fault))

    def check_share(self, path: Path) -> None:
        """Raise `RecordingError` if too many records of the log at `path` are bad."""
        if self.bad_count > max(FEW_BAD, BAD_SHARE * self.records):
            first = min(self.bad, key=lambda bad: bad.line)
            raise damaged_line(
                path,
                first.line,
                f"{first.fault}; so {self.bad_count} of {self.records} records are bad, more than "
                f"{BAD_SHARE:.0%}",
            )


def read_log(path: Path) -> CarmenLog:
    """Read all records of the log at `path`, plain or compressed.

    Bad records are left out and counted. Raises `RecordingError` if they are too many, or if the
    log cannot be read.
    """
    log = CarmenLog()
    for line, text in text_lines(path):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            log.records += _add(log, words, line)
        except _DamageError as damage:
            log.records += 1
            log.reject(line, str(damage))
    log.check_share(path)
    if not log.odometry and not log.lasers:
        bad = f" Its line {log.bad[0].line} is damaged: {log.bad[0].fault}." if log.bad else ""
        raise RecordingError(
            f"{path} holds neither odometry (ODOM) nor laser scans (FLASER, ROBOTLASER1, "
            f"RAWLASER1) that can be used.{bad} It is empty or cut off: take a fresh copy of the "
            "data set."
        )
    return log


class _DamageError(ValueError):
    pass


def _add(log: CarmenLog, words: list[str], line: int) -> bool:
    """Add a record; return whether it is of a kind that is read."""
    kind = words[0]
    if kind == "ODOM":
        _check_count(words, 7 + _STAMP)
        x, y, theta, forward, turn = _numbers(words[1:6], "pose or velocity")
        log.odometry.append(
            OdometryLine(_stamp(words), (x, y, theta), forward, turn, line, _logger_s(words))
        )
    elif kind == "FLASER":
        scan = _flaser(words, line)
        log.lasers.setdefault(kind, []).append(scan)
    elif kind in ("RAWLASER1", "ROBOTLASER1"):
        scan = _laser(words, line)
        log.lasers.setdefault(kind, []).append(scan)
    elif kind == "TRUEPOS":
        _check_count(words, 7 + _STAMP)
        x, y, theta = _numbers(words[1:4], "pose")
        log.true_poses.append(TruePose(_stamp(words), (x, y, theta), line))
    else:
        if kind != "PARAM":
            log.others[kind] += 1
        elif len(words) >= 3:
            log.parameters[words[1]] = words[2]
        return False
    return True


def _flaser(words: list[str], line: int) -> LaserLine:
    """Parse `FLASER n [ranges]`, laser's x y theta, robot's x y theta."""
    count = _whole(words, 1)
    _check_count(words, 2 + count + 6 + _STAMP)
    ranges = _ranges(words[2 : 2 + count])
    x, y, theta, robot_x, robot_y, robot_theta = _numbers(words[2 + count : 8 + count], "pose")
    robot = (robot_x, robot_y, robot_theta)
    return LaserLine(
        _stamp(words), ranges, _sick(count), (x, y, theta), robot, line, _logger_s(words)
    )


_MOST_TURN_RAD = 2.5 * math.pi  # of a sweep, as in a LaserScan


def _laser(words: list[str], line: int) -> LaserLine:
    """Parse the newer kinds, which describe their beams; ROBOTLASER1 has poses as well.

    Fields: laser_type start_angle fov angular_resolution maximum_range accuracy remission_mode
    n [ranges] m [remissions], and laser's x y theta, robot's x y theta, velocities and distances.
    """
    count = _whole(words, 8)
    first, fov, step, longest = _numbers(words[2:6], "description of the laser")
    remissions = 9 + count
    rest = remissions + 1 + _whole(words, remissions)
    poses = words[0] == "ROBOTLASER1"
    _check_count(words, rest + (11 if poses else 0) + _STAMP)
    # Some programs write the number of steps instead of the angle between them.
    if count > 1 and (step == 0 or abs(step) * (count - 1) > _MOST_TURN_RAD):
        step = fov / (count - 1)
    if 0 < longest <= SHORTEST_M:
        raise _DamageError(f"the longest range is {longest:g} m, not above {SHORTEST_M:g} m")
    beams = BeamLayout(first, step, longest if longest > 0 else None)
    laser = robot = velocity = None
    if poses:
        x, y, theta, robot_x, robot_y, robot_theta, forward, turn = _numbers(
            words[rest : rest + 8], "pose or velocity"
        )
        laser, robot = (x, y, theta), (robot_x, robot_y, robot_theta)
        velocity = (forward, turn)
    ranges = _ranges(words[9:remissions])
    return LaserLine(_stamp(words), ranges, beams, laser, robot, line, _logger_s(words), velocity)


def _sick(count: int) -> BeamLayout:
    """Return the beams of a SICK LMS by their number; an even number lacks the last one."""
    if count in (180, 181, 360, 361):
        return BeamLayout(-math.pi / 2, math.radians(1.0 if count < 200 else 0.5))
    if count in (400, 401):
        return BeamLayout(math.radians(-50.0), math.radians(0.25))
    return BeamLayout(-math.pi / 2, math.pi / max(count - 1, 1), assumed=True)


def _check_count(words: list[str], expected: int) -> None:
    if len(words) != expected:
        raise _DamageError(f"{words[0]} has {len(words)} fields instead of {expected}")


def _whole(words: list[str], index: int) -> int:
    text = words[index] if index < len(words) else ""
    if not text.isdecimal() or int(text) > 100_000:
        raise _DamageError(f"{words[0]}: {text!r} is not a number of readings")
    return int(text)


def _stamp(words: list[str]) -> int:
    """Return the time at which a message was sent [ns], exactly as it is written."""
    return _time(words[-_STAMP])


def _logger_s(words: list[str]) -> float:
    """Return the time at which a record was logged [s], NaN if there is none."""
    stamp = _time(words[-1])
    return math.nan if stamp == NO_TIME else stamp / SECOND


def _time(text: str) -> int:
    """Return a time [ns]; `NO_TIME` if the text is not one, or is rounded to more than a second.

    Programs that print a time with six digits write 1.01893e+09, which is the same for hours.
    """
    whole, _, fraction = text.partition(".")
    if whole.isdecimal() and len(whole) <= 10 and (fraction.isdecimal() or not fraction):
        stamp = int(whole) * SECOND + int(fraction[:9].ljust(9, "0"))
        return stamp if stamp < _LATEST_S * SECOND else NO_TIME
    try:
        time = Decimal(text)
    except InvalidOperation:
        return NO_TIME
    digits_end = time.as_tuple().exponent
    if not isinstance(digits_end, int) or digits_end > 0 or abs(float(time)) >= _LATEST_S:
        return NO_TIME
    return round(float(time) * 1e6) * 1000  # to microseconds, the precision of a double


def _ranges(words: list[str]) -> NDArray[np.float32]:
    """Return ranges [m]; as in REP 117, inf without a return, nan of a failed measurement."""
    others = [word for word in words if word not in ("inf", "nan", "-nan")]
    if len(others) < len(words):
        _numbers(others, "range")
        ranges = np.array([float(word) for word in words], dtype=np.float32)
    else:
        ranges = np.array(_numbers(words, "range"), dtype=np.float32)
    least = float(np.nanmin(ranges, initial=0.0))
    if least < 0:
        raise _DamageError(f"a range is {least:g} m")
    return ranges


def _numbers(words: list[str], meaning: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise _DamageError(f"{meaning}: not a number among {' '.join(words)[:60]!r}") from None
    if not all(map(math.isfinite, numbers)):
        raise _DamageError(f"{meaning}: not a finite number among {' '.join(words)[:60]!r}")
    if numbers and (max(numbers) > _LARGEST or min(numbers) < -_LARGEST):
        raise _DamageError(f"{meaning}: a number above {_LARGEST:g} in {' '.join(words)[:60]!r}")
    return numbers
