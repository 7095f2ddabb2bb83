"""CARMEN logs: the streams that they hold, from lines of which some are bad and times wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cairn import from_ns
from cairn.components.replay_devices.carmen_lines import (
    SHORTEST_M,
    LaserLine,
    OdometryLine,
    TruePose,
    read_log,
)
from cairn.components.replay_devices.carmen_odometry import (
    corrected_poses,
    median_mount,
    rejoin_increments,
    restore_driving_direction,
    with_poses_at_scans,
)
from cairn.components.replay_devices.record_times import (
    NO_TIME,
    RepairedTimes,
    TimeQuality,
    repair_times,
    time_quality,
    times_along_path,
    times_by_order,
    with_repair,
    wrong_times,
)
from cairn.components.replay_devices.recording import (
    BAD_SHARE,
    FEW_BAD,
    OdometryStream,
    RecordedTopic,
    Recording,
    ScannerMount,
    ScanStream,
    TimedPoses,
    covariances_of,
    damaged_line,
)
from cairn.components.replay_devices.wheel_odometry import (
    odometry_deviations,
    odometry_velocities,
    velocities_agree,
)
from cairn.errors import RecordingError
from cairn.planar.poses import Pose
from cairn.schemas.message import InvalidMessage
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]
Line = TypeVar("Line", OdometryLine, LaserLine, TruePose)
Message = TypeVar("Message", OdometryLine, LaserLine)

_SCAN_LINES = ("FLASER", "ROBOTLASER1", "RAWLASER1")  # the first that a log holds is replayed
# A SICK LMS encodes the reason for a missing range in centimeters: 8183 means beyond its reach,
# 8186 to 8191 an error such as dazzling or a weak signal, which also happens at edges. [m]
_SICK_LONGEST, _SICK_ERRORS = 81.83, 81.855
_MOST_NAMED = 5  # bad records that a note names


@dataclass(frozen=True)
class _Track(Generic[Message]):
    """Lines in temporal order, with repaired times; `recorded` [ns] are those in the log."""

    lines: list[Message]
    recorded: list[int]
    quality: TimeQuality


class CarmenRecording(Recording):
    """The log at `path`: wheel odometry, one front laser, and corrected poses if it has them.

    If the poses in its laser records are odometry, the odometry at the time of a scan is that of
    its own record. Scans and their corrected poses get a time `scan_delay_s` [s] before the one in
    the log.
    """

    def __init__(self, path: Path, scan_delay_s: float = 0.0) -> None:
        """Read the whole log; raises `RecordingError`."""
        self._path = path
        self._log = read_log(path)
        self._notes: list[str] = []
        kinds = [kind for kind in _SCAN_LINES if kind in self._log.lasers]
        lasers = self._log.lasers[kinds[0]] if kinds else []
        self._kind = kinds[0] if kinds else ""
        wheels = rejoin_increments(self._log.odometry, lasers)
        lasers, odometry = self._with_usable_times(lasers, wheels.lines)
        lasers = self._timely(lasers)
        odometry = self._timely(odometry)
        self._true_poses = _sorted(self._timely(self._log.true_poses))
        self._log.check_share(path)
        self._note_bad_records()
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
        self._corrected = corrected_poses(
            _sorted(_unique(odometry)), _sorted(_unique(lasers)), wheels.anchors
        )
        self._read_streams(odometry, lasers, scan_delay_s)

    def _read_streams(
        self, odometry: list[OdometryLine], lasers: list[LaserLine], scan_delay_s: float
    ) -> None:
        are_raw = self._corrected is None
        at_scans = _in_time(lasers, are_raw)
        moves = _in_time(odometry, are_raw)
        self._lasers: list[LaserLine] = at_scans.lines
        self._recorded_stamps = at_scans.recorded
        delay = round(scan_delay_s * 1e9)
        self._laser_stamps = [max(line.stamp - delay, 0) for line in self._lasers]
        self._quality = {}
        steps: list[OdometryLine] = moves.lines
        contradicting = 0
        self._own_odometry = are_raw and bool(lasers) and lasers[0].robot is not None
        if self._own_odometry:
            merged = with_poses_at_scans(moves.lines, self._lasers)
            steps, contradicting = merged.lines, merged.contradicting
            if delay:
                self._notes.append(
                    f"scans are put {scan_delay_s:g} s before the odometry in their own records: "
                    "set scan_delay_s to 0, unless this delay was measured for this log"
                )
        if odometry:
            self._quality["odom"] = replace(moves.quality, contradicting=contradicting)
        if lasers:
            self._quality["scan"] = at_scans.quality
        self._note_times()
        restored = restore_driving_direction(steps)
        if restored.wrong_m:
            self._notes.append(
                f"odometry counted {restored.wrong_m:.1f} m of driving backwards as forward: "
                "corrected by the sign of its velocities"
            )
        self._odometry = self._from_wheels(restored.lines)

    def _with_usable_times(
        self, lasers: list[LaserLine], odometry: list[OdometryLine]
    ) -> tuple[list[LaserLine], list[OdometryLine]]:
        """Return the lines with the times of the messages, of the logger, or by their order."""
        streams: dict[str, Sequence[LaserLine | OdometryLine]] = {self._kind: lasers}
        streams = {kind: lines for kind, lines in (streams | {"ODOM": odometry}).items() if lines}
        sent, logged = _Clock(streams, lambda line: line.stamp), _Clock(streams, _logged)
        if not sent.lacking:
            return lasers, odometry
        clock = logged if logged.missing < sent.missing else sent
        if clock is logged:
            self._notes.append("the times of messages cannot be used: those of the logger are")
        known = sorted(
            (line.line, clock.stamps[kind][index])
            for kind, lines in streams.items()
            for index, line in enumerate(lines)
            if index not in clock.wrong[kind]
        )
        if not known:
            first, lines = next(iter(streams.items()))
            poses = np.array([_pose_of(line) or (0.0, 0.0, 0.0) for line in lines])
            known = list(zip([line.line for line in lines], times_along_path(poses), strict=True))
            self._notes.append(
                f"no times can be used: those of {first} are made as if the robot drove at a usual "
                "speed"
            )
        for kind in clock.lacking:
            self._notes.append(
                f"the times of {len(clock.wrong[kind])} {kind} cannot be used: they follow from "
                "the order of the file"
            )
            numbers = [line.line for line in streams[kind]]
            for index, stamp in enumerate(times_by_order(numbers, known)):
                if index in clock.wrong[kind]:
                    clock.stamps[kind][index] = stamp
        return (
            _with_stamps(lasers, clock.stamps.get(self._kind, [])),
            _with_stamps(odometry, clock.stamps.get("ODOM", [])),
        )

    def _timely(self, lines: list[Line]) -> list[Line]:
        """Return the lines without those of which the time is wrong, which count as bad records."""
        wrong = wrong_times([line.stamp for line in lines])
        for one in wrong:
            self._log.reject(lines[one.index].line, one.fault)
        indices = {one.index for one in wrong}
        return [line for index, line in enumerate(lines) if index not in indices]

    def _note_bad_records(self) -> None:
        log = self._log
        if log.bad_count:
            first = sorted(log.bad, key=lambda bad: bad.line)[:_MOST_NAMED]
            named = "; ".join(f"line {bad.line}: {bad.fault}" for bad in first)
            more = "; ..." if log.bad_count > len(first) else ""
            self._notes.append(
                f"{log.bad_count} of {log.records} records are bad and left out: {named}{more}"
            )

    def _note_times(self) -> None:
        for kind, quality in self._quality.items():
            name = {"odom": "ODOM", "scan": self._kind}[kind]
            if quality.duplicates:
                self._notes.append(f"{quality.duplicates} duplicates of {name} are left out")
            if quality.retimed:
                self._notes.append(
                    f"times of {quality.retimed} {name} are corrected by up to "
                    f"{quality.shift_s:.3f} s: they came in bursts or out of order"
                )
            if quality.contradicting:
                self._notes.append(
                    f"{quality.contradicting} {name} are left out: they contradict the odometry "
                    "in the laser records"
                )

    def span(self) -> tuple[int, int]:
        """Return the times [ns] of the first and the last scan or odometry."""
        odometry = self._odometry.stamps if self._odometry else ()
        ends = [*odometry[:1], *odometry[-1:], *self._laser_stamps[:1], *self._laser_stamps[-1:]]
        return min(ends), max(ends)

    def odometry(self) -> OdometryStream | None:
        """Return the robot's raw poses at its scans, and those of ODOM lines that agree."""
        return self._odometry

    def scans(self) -> ScanStream | None:
        """Return the front laser's scans; +inf where nothing was in reach, NaN where it failed."""
        if not self._lasers:
            return None
        pairs = zip(self._laser_stamps, self._lasers, strict=True)
        messages = [self._scan(stamp, line) for stamp, line in pairs]
        return ScanStream(self._laser_stamps, messages, self._recorded_stamps)

    def mount(self) -> ScannerMount | None:
        """Return the scanner's pose by the laser records, else by the log's parameters.

        It is unknown if laser and robot have the same pose in all records.
        """
        pose = median_mount(self._lasers)
        if pose is not None and any(abs(value) > 1e-6 for value in pose):
            return ScannerMount(pose, False, "base_link", f"{self._kind} records")
        names = ("offset", "side_offset", "angular_offset")
        values = [self._log.parameters.get(f"robot_frontlaser_{name}") for name in names]
        if values[0] is None:
            return None
        x, y, yaw = (_parse_number(value or "0") for value in values)
        return ScannerMount((x, y, yaw), False, "base_link", "PARAM robot_frontlaser_offset")

    def truth(self) -> TimedPoses | None:
        """Return a simulator's true poses, or the robot's corrected poses at its scans."""
        if self._true_poses:
            poses = np.array([true.pose for true in self._true_poses])
            return TimedPoses([true.stamp for true in self._true_poses], poses)
        if self._corrected is None:
            return None
        return TimedPoses(self._laser_stamps, self._corrected)

    def topics(self) -> Sequence[RecordedTopic]:
        """Return the kinds of the log's lines."""
        log = self._log
        found: list[RecordedTopic] = []
        if log.odometry:
            found.append(RecordedTopic("odom", "ODOM", "wheel odometry", len(log.odometry)))
        if self._own_odometry:
            found.append(RecordedTopic("odom", self._kind, "robot's pose", len(self._lasers)))
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

    def time_quality(self) -> Mapping[str, TimeQuality]:
        """Return the quality of the times of ODOM lines and of scans."""
        return self._quality

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
        if not lines:
            return None
        stamps = [line.stamp for line in lines]
        poses = np.array([line.pose for line in lines])
        twists = np.array([(line.forward, line.turn) for line in lines])
        if not twists.any() or not velocities_agree(stamps, poses, twists):
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
            ranges[(line.ranges > _SICK_ERRORS) & np.isfinite(line.ranges)] = math.nan
        try:
            return LaserScan(
                header=Header(stamp=from_ns(stamp), frame_id="laser"),
                angle_min=line.beams.first,
                angle_max=line.beams.first + (ranges.size - 1) * line.beams.step,
                angle_increment=line.beams.step,
                range_min=SHORTEST_M,
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


class _Clock:
    """Times [ns] of the records of each kind, and the indices of those that are wrong.

    They all are if most are wrong or the same. A kind is `lacking` if more of its times are wrong
    than records may be bad; `missing` is the number of their records.
    """

    def __init__(
        self,
        streams: Mapping[str, Sequence[LaserLine | OdometryLine]],
        stamp_of: Callable[[LaserLine | OdometryLine], int],
    ) -> None:
        self.stamps = {kind: [stamp_of(line) for line in of] for kind, of in streams.items()}
        self.wrong: dict[str, set[int]] = {}
        self.lacking: list[str] = []
        for kind, stamps in self.stamps.items():
            wrong = {one.index for one in wrong_times(stamps)}
            if 2 * max(len(wrong), len(stamps) - len(set(stamps))) > len(stamps):
                wrong = set(range(len(stamps)))
            self.wrong[kind] = wrong
            if len(wrong) > max(FEW_BAD, BAD_SHARE * len(stamps)):
                self.lacking.append(kind)
        self.missing = sum(len(self.wrong[kind]) for kind in self.lacking)


def _logged(line: LaserLine | OdometryLine) -> int:
    """Return the time [ns] at which a line was logged."""
    return NO_TIME if math.isnan(line.logger_s) else round(line.logger_s * 1e6) * 1000


def _with_stamps(lines: list[Message], stamps: Sequence[int]) -> list[Message]:
    return [
        line if line.stamp == stamp else replace(line, stamp=stamp)
        for line, stamp in zip(lines, stamps, strict=True)
    ]


def _sorted(lines: list[Line]) -> list[Line]:
    return sorted(lines, key=lambda line: line.stamp)


def _in_time(lines: list[Message], are_raw: bool) -> _Track[Message]:
    """Return the lines in temporal order, without duplicates; times are repaired if `are_raw`.

    Times in a corrected log stay: it has only some of the scans, and they are not in bursts.
    """
    unique = _unique(lines)
    recorded = np.array([line.stamp for line in unique], dtype=np.int64)
    if are_raw:
        poses = [_pose_of(line) for line in unique]
        moved = None if None in poses else np.array(poses).reshape(-1, 3)
        logger_s = np.array([line.logger_s for line in unique])
        repaired = repair_times(recorded.tolist(), logger_s, moved)
    else:
        order = np.argsort(recorded, kind="stable")
        repaired = RepairedTimes(order, recorded[order])
    ordered = _with_stamps([unique[k] for k in repaired.order], repaired.stamps.tolist())
    quality = with_repair(time_quality(recorded), recorded, repaired)
    duplicates = len(lines) - len(unique)
    return _Track(
        ordered, recorded[repaired.order].tolist(), replace(quality, duplicates=duplicates)
    )


def _unique(lines: list[Message]) -> list[Message]:
    """Return the lines without repetitions of the same message, of which the first stays."""
    return list({_identity(line): line for line in reversed(lines)}.values())[::-1]


def _identity(line: OdometryLine | LaserLine) -> tuple[object, ...]:
    """Return what two records of the same message have in common."""
    if isinstance(line, OdometryLine):
        return line.stamp, line.pose, line.forward, line.turn
    return line.stamp, line.robot, line.ranges.tobytes()


def _pose_of(line: OdometryLine | LaserLine) -> Pose | None:
    return line.pose if isinstance(line, OdometryLine) else line.robot


def _parse_number(text: str) -> float:
    """Return a parameter as a number, 0 if it is not a finite one."""
    try:
        number = float(text)
    except ValueError:
        return 0.0
    return number if math.isfinite(number) else 0.0


def _parse_length(text: str) -> float | None:
    """Return a parameter as a length [m], None if it is not a length."""
    length = _parse_number(text)
    return length if length > 0 else None
