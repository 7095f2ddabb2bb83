"""CARMEN logs: their lines, what their poses mean, and the streams that they hold.

Format: the log's own header, and `log_param.h`, `readlog.c` of the Carnegie Mellon Navigation
Toolkit. Every line ends in `ipc_timestamp ipc_hostname logger_timestamp`; times are those of
`ipc_timestamp` [s], at which the message was sent.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cairn import from_ns
from cairn.components.replay.bounded_streams import text_lines
from cairn.components.replay.recording import (
    ImageStream,
    ObservationStream,
    OdometryStream,
    RecordedTopic,
    ScanStream,
    TimedPoses,
    covariances_of,
    damaged_line,
    nanoseconds,
)
from cairn.components.replay.wheel_odometry import (
    odometry_deviations,
    odometry_velocities,
    velocities_agree,
)
from cairn.errors import RecordingError
from cairn.planar.poses import Pose, compose, inverse, relative, wrap_all
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.message import InvalidMessage
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]

_SCAN_LINES = ("FLASER", "ROBOTLASER1", "RAWLASER1")  # the first that a log holds is replayed
# A SICK LMS encodes the reason for a missing range in centimeters: 8183 means beyond its reach,
# 8186 to 8191 an error such as dazzling or a weak signal, which also happens at edges. [m]
_SICK_LONGEST, _SICK_ERRORS = 81.83, 81.855
_SHORTEST = 0.02  # [m]; some lasers report zero where they measured nothing
_JITTER_S = 1.0  # how far lines may be out of temporal order
_LONGEST_GAP_S = 3600.0


class CarmenRecording:
    """The log at `path`: wheel odometry, one front laser, and corrected poses if it has them.

    Scans and their corrected poses get a time `scan_delay_s` [s] before the one in the log.
    """

    def __init__(self, path: Path, scan_delay_s: float = 0.0) -> None:
        """Read the whole log; raises `RecordingError`."""
        self._path = path
        self._log = read_log(path)
        kinds = [kind for kind in _SCAN_LINES if kind in self._log.lasers]
        lasers = self._log.lasers[kinds[0]] if kinds else []
        self._kind = kinds[0] if kinds else ""
        wheels = rejoin_increments(self._log.odometry, lasers)
        self._lasers = _in_order(path, lasers)
        times = np.array([line.time for line in self._lasers])
        self._laser_stamps = nanoseconds(np.maximum(times - scan_delay_s, 0.0))
        odometry = _in_order(path, wheels.lines)
        self._corrected = corrected_poses(odometry, self._lasers)
        self._notes: list[str] = []
        if len(kinds) > 1:
            self._notes.append(f"{kinds[0]} is replayed, not {' or '.join(kinds[1:])} as well")
        left_out = sorted(kind for kind in self._log.others if "LASER" in kind)
        if left_out:
            self._notes.append(f"{' and '.join(left_out)} are left out: not from the front laser")
        if wheels.anchors:
            self._notes.append(
                f"odometry was set to the corrected pose {wheels.anchors} times: it is "
                "rejoined from its increments"
            )
        if lasers and lasers[0].beams.assumed:
            self._notes.append(
                f"{lasers[0].ranges.size} beams are not those of a SICK laser: assumed to be "
                "spread evenly over 180 degrees"
            )
        restored = restore_driving_direction(odometry)
        if restored.wrong_m:
            self._notes.append(
                f"odometry counted {restored.wrong_m:.1f} m of driving backwards as forward: "
                "corrected by the sign of its velocities"
            )
        self._odometry = self._from_wheels(restored.lines)

    def span(self) -> tuple[int, int]:
        """Return the times [ns] of the first and the last scan or odometry."""
        odometry = self._odometry.stamps if self._odometry else ()
        ends = [*odometry[:1], *odometry[-1:], *self._laser_stamps[:1], *self._laser_stamps[-1:]]
        return min(ends), max(ends)

    def odometry(self) -> OdometryStream | None:
        """Return the poses of ODOM lines; without these, the robot's raw poses at its scans."""
        return self._odometry

    def scans(self) -> ScanStream | None:
        """Return the front laser's scans; +inf where nothing was in reach, NaN where it failed."""
        if not self._lasers:
            return None
        pairs = zip(self._laser_stamps, self._lasers, strict=True)
        return ScanStream(self._laser_stamps, [self._scan(stamp, line) for stamp, line in pairs])

    def observations(self) -> ObservationStream | None:
        """Return None: CARMEN logs have no observations of landmarks."""
        return None

    def images(self) -> ImageStream | None:
        """Return None: CARMEN logs have no images."""
        return None

    def truth(self) -> TimedPoses | None:
        """Return a simulator's true poses, or the robot's corrected poses at its scans."""
        if self._log.true_poses:
            times = np.array([true.time for true in self._log.true_poses])
            return TimedPoses(nanoseconds(times), np.array([t.pose for t in self._log.true_poses]))
        if self._corrected is None:
            return None
        return TimedPoses(self._laser_stamps, self._corrected)

    def landmark_map(self) -> VisualMap | None:
        """Return None: CARMEN logs have no landmarks."""
        return None

    def topics(self) -> Sequence[RecordedTopic]:
        """Return the kinds of the log's lines."""
        log = self._log
        found = (
            [RecordedTopic("odom", "ODOM", "wheel odometry", len(log.odometry))]
            if log.odometry
            else []
        )
        if self._odometry is not None and not found:
            found = [RecordedTopic("odom", self._kind, "robot's pose", len(self._lasers))]
        for kind, lines in log.lasers.items():
            replayed = "scan" if kind == self._kind else None
            found.append(RecordedTopic(replayed, kind, "laser scan", len(lines)))
        if log.true_poses:
            found.append(RecordedTopic("truth", "TRUEPOS", "simulator's pose", len(log.true_poses)))
        elif self._corrected is not None:
            found.append(RecordedTopic("truth", self._kind, "corrected pose", len(self._lasers)))
        return [
            *found,
            *(RecordedTopic(None, kind, "", n) for kind, n in sorted(log.others.items())),
        ]

    def notes(self) -> Sequence[str]:
        """Return what was assumed or left out."""
        return self._notes

    def posed_scans(self) -> Iterator[tuple[Pose, LaserScan]]:
        """Yield the laser's corrected pose at each scan, and the scan."""
        if self._corrected is None:
            raise RecordingError(
                f"{self._path} holds no corrected poses: those of its scans are raw odometry, "
                "or missing. Use a log that a SLAM program has corrected, such as CARMEN's vasco "
                "or GMapping; a map cannot be drawn from uncorrected odometry."
            )
        for stamp, line in zip(self._laser_stamps, self._lasers, strict=True):
            assert line.laser is not None  # else the log is not corrected
            yield line.laser, self._scan(stamp, line)

    def _from_wheels(self, lines: list[OdometryLine]) -> OdometryStream | None:
        """Return the odometry, with the recorded velocities if they agree with the poses."""
        twists = np.array([(line.forward, line.turn) for line in lines])
        poses = np.array([line.pose for line in lines])
        times = np.array([line.time for line in lines])
        if not lines:
            if self._corrected is not None or not self._lasers or self._lasers[0].robot is None:
                return None
            poses = np.array([line.robot for line in self._lasers])
            times = np.array([line.time for line in self._lasers])
        stamps = nanoseconds(times)
        if not lines or not velocities_agree(stamps, poses, twists):
            twists = odometry_velocities(stamps, poses)
            self._notes.append(
                "velocities are computed from the poses: the recorded ones are missing or disagree"
            )
        return OdometryStream(stamps, poses, covariances_of(odometry_deviations(poses)), twists)

    def _scan(self, stamp: int, line: LaserLine) -> LaserScan:
        longest = line.beams.longest
        if longest is None:
            parameter = self._log.parameters.get("robot_front_laser_max", "")
            longest = _parse_length(parameter) or _SICK_LONGEST
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
            raise damaged_line(self._path, line.line, str(error)) from error


def posed_scans(path: Path) -> Iterator[tuple[Pose, LaserScan]]:
    """Yield the scans of a corrected CARMEN log, each with the pose of the laser in the map.

    A map drawn from them assumes the scanner at the robot's origin. Raises `RecordingError` for a
    log that is damaged or not corrected.
    """
    return CarmenRecording(path).posed_scans()


def _in_order(path: Path, lines: list[Line]) -> list[Line]:
    """Sort lines by their times; raises `RecordingError` where these are wrong."""
    latest = lines[0].time if lines else 0.0
    for line in lines:
        if line.time < 0:
            raise damaged_line(path, line.line, f"time is {line.time:.3f} s")
        if line.time < latest - _JITTER_S:
            raise damaged_line(
                path,
                line.line,
                f"time runs backwards, from {latest:.3f} s to {line.time:.3f} s",
            )
        if line.time > latest + _LONGEST_GAP_S:
            after_s = line.time - latest
            raise damaged_line(path, line.line, f"{after_s:.0f} s pass since the record before it")
        latest = max(latest, line.time)
    return sorted(lines, key=lambda line: line.time)


def _parse_length(text: str) -> float | None:
    """Return a parameter as a length [m], None if it is not a length."""
    try:
        length = float(text)
    except ValueError:
        return None
    return length if math.isfinite(length) and length > 0 else None


MESSAGES = ("PARAM", "SYNC", "ODOM", "FLASER", "RLASER", "TRUEPOS", "RAWLASER1", "ROBOTLASER1")
"""Names at the start of lines of a CARMEN log, among others."""

_STAMP = 3  # the fields that end each line
_LATEST = 2.0**31
_LARGEST = 1e9  # of ranges, poses and velocities: no robot goes so far


@dataclass(frozen=True, slots=True)
class OdometryLine:
    """Pose [m, m, rad] and velocities [m/s, rad/s] of the robot, from its wheels."""

    time: float
    pose: Pose
    forward: float
    turn: float
    line: int


@dataclass(frozen=True, slots=True)
class LaserLine:
    """One scan: `ranges` [m] in `beams`, and the recorded poses of laser and robot."""

    time: float
    ranges: NDArray[np.float32]
    beams: BeamLayout
    laser: Pose | None
    robot: Pose | None
    line: int


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
    """The true pose of a simulated robot."""

    time: float
    pose: Pose


@dataclass
class CarmenLog:
    """The records of a log in the order of its lines; other kinds are only counted."""

    odometry: list[OdometryLine] = field(default_factory=list)
    lasers: dict[str, list[LaserLine]] = field(default_factory=dict)
    true_poses: list[TruePose] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)


def read_log(path: Path) -> CarmenLog:
    """Read all records of the log at `path`, plain or compressed; raises `RecordingError`."""
    log = CarmenLog()
    for line, text in text_lines(path):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            _add(log, words, line)
        except _DamageError as damage:
            raise damaged_line(path, line, str(damage)) from None
    if not log.odometry and not log.lasers:
        raise RecordingError(
            f"{path} holds neither odometry (ODOM) nor laser scans (FLASER, ROBOTLASER1, "
            "RAWLASER1). It is empty or cut off: take a fresh copy of the data set."
        )
    return log


class _DamageError(ValueError):
    pass


def _add(log: CarmenLog, words: list[str], line: int) -> None:
    kind = words[0]
    if kind == "ODOM":
        _check_count(words, 7 + _STAMP)
        x, y, theta, forward, turn = _numbers(words[1:6], "pose or velocity")
        log.odometry.append(OdometryLine(_time(words), (x, y, theta), forward, turn, line))
    elif kind == "FLASER":
        log.lasers.setdefault(kind, []).append(_flaser(words, line))
    elif kind in ("RAWLASER1", "ROBOTLASER1"):
        log.lasers.setdefault(kind, []).append(_laser(words, line))
    elif kind == "TRUEPOS":
        _check_count(words, 7 + _STAMP)
        x, y, theta = _numbers(words[1:4], "pose")
        log.true_poses.append(TruePose(_time(words), (x, y, theta)))
    elif kind == "PARAM":
        if len(words) >= 3:
            log.parameters[words[1]] = words[2]
    else:
        log.others[kind] += 1


def _flaser(words: list[str], line: int) -> LaserLine:
    """Parse `FLASER n [ranges]`, laser's x y theta, robot's x y theta."""
    count = _whole(words, 1)
    _check_count(words, 2 + count + 6 + _STAMP)
    ranges = _ranges(words[2 : 2 + count])
    x, y, theta, robot_x, robot_y, robot_theta = _numbers(words[2 + count : 8 + count], "pose")
    return LaserLine(
        _time(words), ranges, _sick(count), (x, y, theta), (robot_x, robot_y, robot_theta), line
    )


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
    if step == 0 and count > 1:
        step = fov / (count - 1)
    beams = BeamLayout(first, step, longest if longest > 0 else None)
    laser = robot = None
    if poses:
        x, y, theta, robot_x, robot_y, robot_theta = _numbers(words[rest : rest + 6], "pose")
        laser, robot = (x, y, theta), (robot_x, robot_y, robot_theta)
    return LaserLine(_time(words), _ranges(words[9:remissions]), beams, laser, robot, line)


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


Line = TypeVar("Line", OdometryLine, LaserLine)

_NEAR_M, _NEAR_RAD = 0.01, 0.01  # median difference of poses that are the same
_MOVING_M_S = 0.02  # a slower robot may stand
_ENOUGH_LINES = 20  # odometry lines that decide whether a log counts backwards as forward


@dataclass(frozen=True)
class RejoinedOdometry:
    """Odometry lines without those that measured nothing, and the number of these."""

    lines: list[OdometryLine]
    anchors: int


def rejoin_increments(
    odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]
) -> RejoinedOdometry:
    """Return raw odometry from lines that restart at each scan's corrected pose.

    GMapping writes such logs: a scan is followed by an ODOM line without a time of its own that
    repeats the scan's corrected pose, and the next lines continue from there. Only the increments
    are measured; they are added up. Lines of other logs are returned unchanged.
    """
    scans = {line.line: line for line in lasers}
    at = sorted([*(line.line for line in odometry), *scans])
    by_line = {line.line: line for line in odometry}
    lines: list[OdometryLine] = []
    to_raw: Pose = (0.0, 0.0, 0.0)
    scan: LaserLine | None = None
    anchors = 0
    for number in at:
        if number in scans:
            scan = scans[number]
            continue
        line = by_line[number]
        if scan is not None and line.pose == scan.robot and line.time < scan.time - 1.0:
            anchors += 1
            if lines:
                to_raw = compose(lines[-1].pose, inverse(line.pose))
        else:
            pose = compose(to_raw, line.pose) if anchors else line.pose
            lines.append(replace(line, pose=pose))
        scan = None
    return RejoinedOdometry(lines, anchors)


@dataclass(frozen=True)
class RestoredOdometry:
    """Odometry lines with the direction of driving corrected, and the distance corrected [m]."""

    lines: list[OdometryLine]
    wrong_m: float


def restore_driving_direction(odometry: Sequence[OdometryLine]) -> RestoredOdometry:
    """Restore driving backwards in odometry that counted all distances as forward.

    Some bases did so, though their velocities have the right sign; so each increment gets the sign
    of its velocity. Lines of other logs are returned unchanged.
    """
    lines = list(odometry)
    backwards = [k for k in range(1, len(lines)) if lines[k].forward < -_MOVING_M_S]
    steps = [relative(a.pose, b.pose) for a, b in pairwise(lines)]
    forward = sum(steps[k - 1][0] > 0 for k in backwards)
    if len(backwards) < _ENOUGH_LINES or forward < 0.8 * len(backwards):
        return RestoredOdometry(lines, 0.0)
    pose = lines[0].pose
    for k, (x, y, theta) in enumerate(steps, start=1):
        sign = -1.0 if lines[k].forward < 0 else 1.0
        pose = compose(pose, (sign * x, sign * y, theta))
        lines[k] = replace(lines[k], pose=pose)
    return RestoredOdometry(lines, sum(abs(steps[k - 1][0]) for k in backwards))


def corrected_poses(odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]) -> Array | None:
    """Return the robot's corrected poses (n, 3) at the scans, None if the log has only odometry.

    A scan's pose is corrected where it differs from the odometry at that time, or where the laser's
    pose moves against the robot's, which some programs leave raw.
    """
    if not lasers or any(line.laser is None or line.robot is None for line in lasers):
        return None
    laser = np.array([line.laser for line in lasers])
    robot = np.array([line.robot for line in lasers])
    mounts = _relative(robot, laser)
    if not _close(mounts, np.broadcast_to(np.median(mounts, axis=0), mounts.shape)):
        return laser
    if len(odometry) < 2:
        return None
    times = np.array([line.time for line in odometry])
    poses = np.array([line.pose for line in odometry])
    scan_times = np.array([line.time for line in lasers])
    wheels = np.column_stack(
        (
            np.interp(scan_times, times, poses[:, 0]),
            np.interp(scan_times, times, poses[:, 1]),
            np.interp(scan_times, times, np.unwrap(poses[:, 2])),
        )
    )
    return None if _close(wheels, robot) else robot


def _relative(origins: Array, poses: Array) -> Array:
    pairs = zip(origins.tolist(), poses.tolist(), strict=True)
    return np.array([relative(tuple(origin), tuple(pose)) for origin, pose in pairs])


def _close(some: Array, others: Array) -> bool:
    """Return whether most poses (n, 3) are the same."""
    apart = np.hypot(some[:, 0] - others[:, 0], some[:, 1] - others[:, 1])
    turned = np.abs(wrap_all(some[:, 2] - others[:, 2]))
    return bool(np.median(apart) < _NEAR_M and np.median(turned) < _NEAR_RAD)
