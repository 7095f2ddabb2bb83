"""The lines of a CARMEN log as records: odometry, laser scans, true poses, parameters.

Format: the log's own header, and `log_param.h`, `readlog.c` of the Carnegie Mellon Navigation
Toolkit. Every line ends in `ipc_timestamp ipc_hostname logger_timestamp`; times taken are those
of `ipc_timestamp` [s], which is when the message was sent.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay.recording import RecordingError
from cairn.components.replay.text_lines import damaged, text_lines
from cairn.planar.poses import Pose

MESSAGES = ("PARAM", "SYNC", "ODOM", "FLASER", "RLASER", "TRUEPOS", "RAWLASER1", "ROBOTLASER1")
"""Names that lines of a CARMEN log begin with, among others."""

_STAMP = 3  # the fields that end each line
_LATEST = 2.0**31


@dataclass(frozen=True)
class OdometryLine:
    """Pose [m, m, rad] and velocities [m/s, rad/s] of the robot, from its wheels."""

    time: float
    pose: Pose
    forward: float
    turn: float
    line: int


@dataclass(frozen=True)
class LaserLine:
    """One scan: `ranges` [m] in `beams`, and where the log says that laser and robot were."""

    time: float
    ranges: NDArray[np.float32]
    beams: Beams
    laser: Pose | None
    robot: Pose | None
    line: int


@dataclass(frozen=True)
class Beams:
    """Direction of the first beam, angle between beams [rad], and the longest range [m].

    `longest` is None where the line does not tell; `assumed` if the angles are a guess.
    """

    first: float
    step: float
    longest: float | None = None
    assumed: bool = False


@dataclass(frozen=True)
class TruePose:
    """Where a simulated robot was."""

    time: float
    pose: Pose


@dataclass
class Log:
    """The records of a log in the order of its lines; those of other kinds are counted."""

    odometry: list[OdometryLine] = field(default_factory=list)
    lasers: dict[str, list[LaserLine]] = field(default_factory=dict)
    true_poses: list[TruePose] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)


def read_log(path: Path) -> Log:
    """All records of the log at `path`, plain or compressed; raises `RecordingError`."""
    log = Log()
    for line, text in text_lines(path):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            _add(log, words, line)
        except _DamageError as damage:
            raise damaged(path, line, str(damage)) from None
    if not log.odometry and not log.lasers:
        raise RecordingError(
            f"{path} holds neither odometry (ODOM) nor laser scans (FLASER, ROBOTLASER1, "
            "RAWLASER1). It is empty or cut off: take a fresh copy of the data set."
        )
    return log


class _DamageError(ValueError):
    pass


def _add(log: Log, words: list[str], line: int) -> None:
    kind = words[0]
    if kind == "ODOM":
        _count(words, 7 + _STAMP)
        x, y, theta, forward, turn = _numbers(words[1:6], "pose or velocity")
        log.odometry.append(OdometryLine(_time(words), (x, y, theta), forward, turn, line))
    elif kind == "FLASER":
        log.lasers.setdefault(kind, []).append(_flaser(words, line))
    elif kind in ("RAWLASER1", "ROBOTLASER1"):
        log.lasers.setdefault(kind, []).append(_laser(words, line))
    elif kind == "TRUEPOS":
        _count(words, 7 + _STAMP)
        x, y, theta = _numbers(words[1:4], "pose")
        log.true_poses.append(TruePose(_time(words), (x, y, theta)))
    elif kind == "PARAM":
        if len(words) >= 3:
            log.parameters[words[1]] = words[2]
    else:
        log.others[kind] += 1


def _flaser(words: list[str], line: int) -> LaserLine:
    """FLASER n [ranges] laser's x y theta, robot's x y theta."""
    count = _whole(words, 1)
    _count(words, 2 + count + 6 + _STAMP)
    ranges = _ranges(words[2 : 2 + count])
    x, y, theta, robot_x, robot_y, robot_theta = _numbers(words[2 + count : 8 + count], "pose")
    return LaserLine(
        _time(words), ranges, _sick(count), (x, y, theta), (robot_x, robot_y, robot_theta), line
    )


def _laser(words: list[str], line: int) -> LaserLine:
    """The newer kinds, which tell of their beams; ROBOTLASER1 has poses beside.

    laser_type start_angle fov angular_resolution maximum_range accuracy remission_mode
    n [ranges] m [remissions], and laser's x y theta, robot's x y theta, velocities and distances.
    """
    count = _whole(words, 8)
    first, fov, step, longest = _numbers(words[2:6], "description of the laser")
    remissions = 9 + count
    rest = remissions + 1 + _whole(words, remissions)
    poses = words[0] == "ROBOTLASER1"
    _count(words, rest + (11 if poses else 0) + _STAMP)
    if step == 0 and count > 1:
        step = fov / (count - 1)
    beams = Beams(first, step, longest if longest > 0 else None)
    laser = robot = None
    if poses:
        x, y, theta, robot_x, robot_y, robot_theta = _numbers(words[rest : rest + 6], "pose")
        laser, robot = (x, y, theta), (robot_x, robot_y, robot_theta)
    return LaserLine(_time(words), _ranges(words[9:remissions]), beams, laser, robot, line)


def _sick(count: int) -> Beams:
    """The beams of a SICK LMS, by their number; the last of an even number was left out."""
    if count in (180, 181, 360, 361):
        return Beams(-math.pi / 2, math.radians(1.0 if count < 200 else 0.5))
    if count in (400, 401):
        return Beams(math.radians(-50.0), math.radians(0.25))
    return Beams(-math.pi / 2, math.pi / max(count - 1, 1), assumed=True)


def _count(words: list[str], due: int) -> None:
    if len(words) != due:
        raise _DamageError(f"{words[0]} has {len(words)} fields where {due} belong")


def _whole(words: list[str], index: int) -> int:
    given = words[index] if index < len(words) else ""
    if not given.isdecimal() or int(given) > 100_000:
        raise _DamageError(f"{words[0]}: {given!r} is no number of readings")
    return int(given)


def _time(words: list[str]) -> float:
    (time,) = _numbers(words[-_STAMP : 1 - _STAMP], "time")
    if not -_LATEST < time < _LATEST:
        raise _DamageError(f"time is {time:g} s")
    return time


def _ranges(words: list[str]) -> NDArray[np.float32]:
    ranges = np.array(_numbers(words, "range"), dtype=np.float32)
    if ranges.size and ranges.min() < 0:
        raise _DamageError(f"a range is {ranges.min():g} m")
    return ranges


def _numbers(words: list[str], what: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise _DamageError(f"{what}: not a number among {' '.join(words)[:60]!r}") from None
    if not all(map(math.isfinite, numbers)):
        raise _DamageError(f"{what}: not a finite number among {' '.join(words)[:60]!r}")
    return numbers
