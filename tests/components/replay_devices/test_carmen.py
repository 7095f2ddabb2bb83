"""CARMEN logs of all kinds: their meaning, and errors with the line of damaged ones."""

import bz2
import gzip
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn import SECOND, to_ns
from cairn.components.replay_devices.carmen import CarmenRecording, posed_scans
from cairn.errors import RecordingError
from cairn.planar.poses import distance, relative, wrap
from tests.components.replay_devices.conftest import FR079, FR101, Write, flaser, odom
from tests.sweeps import sampled
from tests.wording import assert_words, words_in_order

pytestmark = pytest.mark.slow


Array = NDArray[np.float64]


def drive(seconds: int) -> list[str]:
    """A log of a robot that drives ahead at 1 m/s, a scan each second."""
    lines = []
    for k in range(10 * seconds + 1):
        lines.append(odom(100 + k / 10, k / 10))
        if k % 10 == 0:
            lines.append(flaser(100 + k / 10, k / 10))
    return lines


def test_raw_log_gives_odometry_and_scans_without_truth(write: Write) -> None:
    recording = CarmenRecording(write("# CARMEN Logfile", "PARAM a b c", "", *drive(5)))

    odometry, scans = recording.odometry(), recording.scans()
    assert odometry is not None
    assert scans is not None
    assert odometry.stamps[:2] == [100 * SECOND, 100 * SECOND + SECOND // 10]
    assert odometry.poses[-1].tolist() == [5.0, 0.0, 0.0]
    assert odometry.twists[7].tolist() == [1.0, 0.0]
    assert [to_ns(m.header.stamp) for m in scans.messages] == scans.stamps
    assert len(scans.stamps) == 6
    assert recording.span() == (100 * SECOND, 105 * SECOND)
    assert recording.truth() is None
    assert list(recording.notes()) == []


def _gzip_in_two_members(data: bytes) -> bytes:
    return gzip.compress(data[:50]) + gzip.compress(data[50:])


@pytest.mark.parametrize("after", [b"", b"\r\n", bytes(512)])
@pytest.mark.parametrize("compress", [gzip.compress, _gzip_in_two_members, bz2.compress])
def test_compressed_log_is_detected_by_its_content(
    write: Write, compress: Callable[[bytes], bytes], after: bytes
) -> None:
    path = write(*drive(2))
    before = CarmenRecording(path).span()
    path.write_bytes(compress(path.read_bytes()) + after)

    assert CarmenRecording(path).span() == before


@pytest.mark.parametrize(
    ("beams", "last_deg"), [(180, 89.0), (181, 90.0), (360, 89.5), (361, 90.0), (401, 50.0)]
)
def test_beam_angles_of_a_sick_laser_follow_from_the_number_of_beams(
    write: Write, beams: int, last_deg: float
) -> None:
    recording = CarmenRecording(write(flaser(1.0, 0.0, (2.0,) * beams)))

    scans = recording.scans()
    assert scans is not None
    (scan,) = scans.messages
    assert math.degrees(scan.angle_max) == pytest.approx(last_deg, abs=1e-4)
    assert math.degrees(scan.angle_min + (beams - 1) * scan.angle_increment) == pytest.approx(
        last_deg, abs=1e-3
    )


def test_beams_of_an_unknown_laser_are_assumed_with_a_note(write: Write) -> None:
    recording = CarmenRecording(write(flaser(1.0, 0.0, (2.0,) * 91)))

    (note, *_) = recording.notes()
    assert_words(note, "91 beams", "SICK")


def test_error_code_is_nan_and_out_of_reach_is_infinity(write: Write) -> None:
    ranges = (1.0, 81.91, 81.83, 3.0, *(1.0,) * 176)
    recording = CarmenRecording(
        write("PARAM robot_front_laser_max 80.99 h 0", flaser(1.0, 0.0, ranges))
    )

    scans = recording.scans()
    assert scans is not None
    assert scans.messages[0].ranges[:4].tolist() == pytest.approx(
        [1.0, math.nan, math.inf, 3.0], nan_ok=True
    )
    assert scans.messages[0].range_max == pytest.approx(80.99)


def test_newer_scan_lines_describe_their_beams(write: Write) -> None:
    laser = "1 -2.0 4.0 1.0 30.0 0.01 0 5 1 2 3 4 30 2 7 8"
    poses = "1.5 2 0.5 1.4 2 0.5"
    recording = CarmenRecording(
        write(
            f"RAWLASER1 {laser} 7.1 host 0.1",
            f"ROBOTLASER1 {laser} {poses} 0 0 0 0 0 7.2 host 0.2",
        )
    )

    scans, odometry = recording.scans(), recording.odometry()
    assert scans is not None
    assert odometry is not None
    (scan,) = scans.messages
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (-2.0, 1.0, 30.0)
    assert scan.ranges.tolist() == [1, 2, 3, 4, math.inf]
    assert odometry.poses.tolist() == [[1.4, 2.0, 0.5]]
    assert any("ROBOTLASER1 is replayed, not RAWLASER1" in note for note in recording.notes())


def test_scans_of_other_lasers_are_left_out_with_a_note(write: Write) -> None:
    recording = CarmenRecording(
        write(flaser(1.0, 0.0), flaser(1.0, 0.0).replace("FLASER", "RLASER"))
    )

    scans = recording.scans()
    assert scans is not None
    assert len(scans.stamps) == 1
    assert any("RLASER are left out" in note for note in recording.notes())


def test_velocities_that_disagree_with_the_poses_are_recomputed(write: Write) -> None:
    recording = CarmenRecording(write(*(odom(5 + k / 10, k / 10, speed=0.001) for k in range(100))))

    odometry = recording.odometry()
    assert odometry is not None
    assert odometry.twists[1:, 0] == pytest.approx(np.ones(99))
    assert any("velocities are computed from the poses" in note for note in recording.notes())


def test_odometry_that_counts_backwards_as_forward_is_corrected(write: Write) -> None:
    lines = [odom(k / 10, k / 10, speed=1.0 if k <= 50 else -1.0) for k in range(101)]

    recording = CarmenRecording(write(*lines))

    odometry = recording.odometry()
    assert odometry is not None
    assert odometry.poses[50, 0] == pytest.approx(5.0)
    assert odometry.poses[100, 0] == pytest.approx(0.0)
    assert odometry.twists[60, 0] == -1.0
    assert any("5.0 m of driving backwards" in note for note in recording.notes())


def test_odometry_set_to_corrected_poses_is_rejoined(write: Write) -> None:
    corrected = "FLASER 1 2.0 1.2 0 0 1.2 0 0 101 host 101"
    marker = "ODOM 1.2 0 0 0 0 0 0 host 0"
    lines = [odom(100, 0.0), odom(101, 1.0), corrected, marker, odom(102, 2.2)]

    recording = CarmenRecording(write(*lines))

    odometry, truth = recording.odometry(), recording.truth()
    assert odometry is not None
    assert truth is not None
    assert odometry.poses[:, 0] == pytest.approx([0.0, 1.0, 2.0])
    assert truth.poses.tolist() == [[1.2, 0.0, 0.0]]
    assert any("set to the corrected pose 1 times" in note for note in recording.notes())


def test_single_line_without_time_does_not_make_a_log_corrected(write: Write) -> None:
    """It has the pose of the scan before it, as the robot stands."""
    lines = [*drive(3), flaser(103.1, 3.0), "ODOM 3.0 0 0 0 0 0 0 host 0"]

    recording = CarmenRecording(write(*lines))

    assert recording.truth() is None
    (note,) = recording.notes()
    assert_words(note, "1 of 37 records are bad", "line 37")


def test_scan_delay_is_subtracted_from_the_stamps_of_a_log(write: Write) -> None:
    recording = CarmenRecording(write(*drive(5)), scan_delay_s=0.25)

    scans, odometry = recording.scans(), recording.odometry()
    assert scans is not None
    assert odometry is not None
    assert [stamp / SECOND for stamp in scans.stamps] == [99.75 + k for k in range(6)]
    assert to_ns(scans.messages[2].header.stamp) == scans.stamps[2]
    assert odometry.stamps[0] == 100 * SECOND
    assert recording.span() == (round(99.75 * SECOND), 105 * SECOND)


def test_true_poses_of_a_simulator_are_the_truth(write: Write) -> None:
    lines = [*drive(1), "TRUEPOS 1 2 0.5 0 0 0 100.5 host 100.5"]

    truth = CarmenRecording(write(*lines)).truth()

    assert truth is not None
    assert truth.poses.tolist() == [[1.0, 2.0, 0.5]]


def test_scan_of_an_impossible_laser_is_a_bad_record(write: Write) -> None:
    laser = "0 -1.5 3.0 1.5 0.01 0.01 0 3 1 1 1 0"  # it reaches 1 cm
    path = write(odom(0.0, 0.0), f"RAWLASER1 {laser} 0.1 host 0.1")

    recording = CarmenRecording(path)

    assert recording.scans() is None
    (note, *_) = recording.notes()
    assert_words(note, "1 of 2 records are bad", "line 2", "longest range is 0.01 m")


def test_recording_may_start_at_any_time(write: Write) -> None:
    recording = CarmenRecording(write(odom(0.0, 0.0), odom(0.1, 0.1)))

    assert recording.span() == (0, SECOND // 10)


BAD_LINES = [
    ("ODOM 1 0 0 1 0 0 9.0 host", "ODOM has 9 fields instead of 10"),
    ("ODOM 1 0 fast 1 0 0 9.0 host 9.0", "not a number among '1 0 fast 1 0'"),
    ("ODOM 1 0 nan 1 0 0 9.0 host 9.0", "not a finite number"),
    ("ODOM 1 1e300 0 1 0 0 9.0 host 9.0", "a number above 1e"),
    ("FLASER 1 1e99 0 0 0 0 0 0 9.0 host 9.0", "a number above 1e"),
    ("ODOM 1 0 0 1 0 0 3.0 host 3.0", "time runs backwards, from 6.000 s to 3.000 s"),
    ("ODOM 1 0 0 1 0 0 0 host 0", "time runs backwards, from 6.000 s to 0.000 s"),
    ("ODOM 1 0 0 1 0 0 -2 host 0", "time is -2.000 s"),
    ("ODOM 1 0 0 1 0 0 9000 host 3.0", "time is 9000.000 s, 8994 s from the others"),
    ("ODOM 1 0 0 1 0 0 1e12 host 3.0", "it has no time that can be used"),
    ("ODOM 1 0 0 1 0 0 9999999999 host 3.0", "it has no time that can be used"),
    ("ODOM 1 0 0 1 0 0 x host 3.0", "it has no time that can be used"),
    ("FLASER 3 1 1 0 0 0 0 0 0 9.0 host 9.0", "FLASER has 13 fields instead of 14"),
    ("FLASER many 1 1 0 0 0 0 0 0 9.0 host 9.0", "'many' is not a number of readings"),
    ("FLASER 1 -2 0 0 0 0 0 0 9.0 host 9.0", "a range is -2 m"),
    ("ROBOTLASER1 0 0 1", "ROBOTLASER1"),
]


@pytest.mark.parametrize(("line", "message"), BAD_LINES)
def test_bad_record_is_left_out_and_named(write: Write, line: str, message: str) -> None:
    recording = CarmenRecording(write(odom(5.0, 0.0), odom(6.0, 1.0), line))

    odometry = recording.odometry()
    assert odometry is not None
    assert list(odometry.stamps) == [5 * SECOND, 6 * SECOND]
    assert recording.scans() is None
    (note, *_) = recording.notes()
    assert_words(note, "1 of 3 records are bad and left out", "line 3")
    assert message in note


def test_log_of_which_more_than_one_percent_is_bad_is_refused(write: Write) -> None:
    line, message = "ODOM 1 0 0 1 0 0 9.0 host", "ODOM has 9 fields instead of 10"
    drive = [odom(5 + k / 10, k / 10) for k in range(405)]

    allowed = CarmenRecording(write(*drive, *[line] * 4))
    assert any("4 of 409 records are bad" in note for note in allowed.notes())
    path = write(*drive, *[line] * 5)
    with pytest.raises(RecordingError) as refused:
        CarmenRecording(path)

    assert f"{path}, line 406: {message}" in str(refused.value)
    assert_words(str(refused.value), "5 of 410 records are bad, more than 1%", "fresh copy")


def test_many_wrong_times_lie_by_order_between_the_right_ones(write: Write) -> None:
    lines = [odom(100 + k / 10, k / 10) for k in range(500)]
    for wrong in range(50, 500, 10):
        lines[wrong] = f"{lines[wrong].rsplit(maxsplit=3)[0]} 7.0 host nan"

    recording = CarmenRecording(write(*lines))

    odometry = recording.odometry()
    assert odometry is not None
    assert [stamp / SECOND for stamp in odometry.stamps] == pytest.approx(
        [100 + k / 10 for k in range(500)]
    )
    assert_words(
        recording.notes()[0], "the times of 45 ODOM cannot be used", "the order of the file"
    )


def with_times(
    lines: list[str], message: Callable[[int], str], logger: Callable[[int], str]
) -> list[str]:
    """Return the lines with other times of messages and logger, by their number."""
    texts = [line.rsplit(maxsplit=3)[0] for line in lines]
    return [f"{text} {message(k)} host {logger(k)}" for k, text in enumerate(texts)]


UNUSABLE = {
    "six digits": lambda k: f"{1018930000.0 + k:g}",
    "subtracted": lambda k: f"{4294967296.0 - k:g}",
    "zero": lambda _: "0",
    "nan": lambda _: "nan",
    "not set": lambda k: str(1e-86 * k if k % 3 else -7.0 * k),
    "backwards": lambda k: f"{5000.0 - 7.0 * k:f}",
}


@pytest.mark.parametrize("times", UNUSABLE)
def test_times_that_cannot_be_used_are_those_of_the_logger_or_by_order(
    write: Write, times: str
) -> None:
    lines = drive(20)
    right = CarmenRecording(write(*lines))
    by_logger = with_times(lines, UNUSABLE[times], lambda k: lines[k].rsplit(maxsplit=1)[1])
    by_order = with_times(lines, UNUSABLE[times], UNUSABLE[times])

    logged, ordered = CarmenRecording(write(*by_logger)), CarmenRecording(write(*by_order))

    scans = right.scans(), logged.scans(), ordered.scans()
    assert scans[0] is not None
    assert scans[1] is not None
    assert scans[2] is not None
    assert list(scans[1].stamps) == list(scans[0].stamps)
    assert_words(" ".join(logged.notes()), "those of the logger are")
    assert len(scans[2].stamps) == len(scans[0].stamps)
    steps = np.diff(np.array(scans[2].stamps)) / SECOND
    assert steps == pytest.approx(2.0)  # 1 m, at 0.5 m/s
    odometry = ordered.odometry()
    assert odometry is not None
    assert np.all(np.diff(odometry.stamps) > 0)
    assert_words(" ".join(ordered.notes()), "no times can be used", "ODOM", "the order of the file")


def test_absurd_times_and_poses_give_times_that_messages_can_have(write: Write) -> None:
    digits = "1" * 1_000_001
    lines = [f"ODOM {(-1) ** k}e9 0 0 0 0 0 {digits}e0 host 0" for k in range(100)]

    odometry = CarmenRecording(write(*lines)).odometry()

    assert odometry is not None
    assert all(0 <= stamp < 2**31 * SECOND for stamp in odometry.stamps)


def test_map_needs_no_times(write: Write) -> None:
    corrected = [f"FLASER 1 2.0 {k}.2 0 0 {k}.2 0 0 0 host 0" for k in range(9)]
    markers = [f"ODOM {k}.2 0 0 0 0 0 {7.5 - 3 * k} host 0" for k in range(9)]
    lines = [line for pair in zip(corrected, markers, strict=True) for line in pair]

    poses = [pose for pose, _ in posed_scans(write(*lines))]

    assert poses == [(k + 0.2, 0.0, 0.0) for k in range(9)]


def test_one_wrong_time_spoils_no_other_record(write: Write) -> None:
    lines = [odom(100 + k / 10, k / 10) for k in range(500)]
    lines[200] = odom(5000.0, 20.0)
    lines[300] = odom(2.0, 30.0)

    recording = CarmenRecording(write(*lines))

    odometry = recording.odometry()
    assert odometry is not None
    assert len(odometry.stamps) == 498
    (note, *_) = recording.notes()
    assert_words(note, "2 of 500 records", "line 201: time is 5000.000 s", "line 301: time runs")


def test_stamps_are_exactly_those_in_the_log(write: Write) -> None:
    written = ["1700000000.123457", "1700000000.223458", "1700000000.3", "1700000001"]
    lines = [flaser(0.0, 0.0).replace("0.000000 host", f"{text} host") for text in written]

    scans = CarmenRecording(write(*lines), scan_delay_s=0.05).scans()

    assert scans is not None
    assert list(scans.recorded_stamps) == [
        1700000000_123457000, 1700000000_223458000, 1700000000_300000000, 1700000001_000000000,
    ]  # fmt: skip
    assert [stamp - 50_000_000 for stamp in scans.recorded_stamps] == list(scans.stamps)


def test_mount_is_that_of_the_laser_records_or_of_a_parameter(write: Write) -> None:
    mount = CarmenRecording(write(flaser(1.0, 0.0))).mount()
    assert mount is not None
    assert (mount.pose, mount.upside_down) == ((0.1, 0.0, 0.0), False)
    assert "FLASER" in mount.source

    scan = flaser(1.0, -0.1).replace("0.0 0 0 -0.1", "-0.1 0 0 -0.1")
    assert CarmenRecording(write(scan)).mount() is None
    mount = CarmenRecording(write("PARAM robot_frontlaser_offset 0.25 h 0", scan)).mount()
    assert mount is not None
    assert mount.pose == (0.25, 0.0, 0.0)
    assert "robot_frontlaser_offset" in mount.source


def test_delay_of_scans_with_their_own_odometry_is_noted(write: Write) -> None:
    recording = CarmenRecording(write(*drive(5)), scan_delay_s=0.25)

    (note,) = recording.notes()
    assert_words(note, "scans are put 0.25 s before", "set scan_delay_s to 0")


def test_cut_off_log_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cut.log.gz"
    path.write_bytes(FR101.read_bytes()[:100_000])

    with pytest.raises(
        RecordingError, match=r"cut.log.gz, line \d+: the compressed stream is broken"
    ):
        CarmenRecording(path)


@pytest.mark.accuracy
def test_corrected_log_of_fr079_is_read_completely() -> None:
    recording = CarmenRecording(FR079)

    odometry, scans, truth = recording.odometry(), recording.scans(), recording.truth()
    assert odometry is not None
    assert scans is not None
    assert truth is not None
    assert len(odometry.stamps) == 8951
    assert len(scans.stamps) == len(truth.stamps) == 2765
    assert any("10.9 m of driving backwards" in note for note in recording.notes())
    first, last = recording.span()
    assert 1061 < (last - first) / SECOND < 1062
    assert truth.poses[0].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.accuracy
def test_posed_scans_have_the_poses_of_the_laser() -> None:
    pairs = list(posed_scans(FR079))

    truth = CarmenRecording(FR079).truth()
    assert truth is not None
    assert len(pairs) == 2765
    for k in (0, 1000, 2764):
        (x, y, theta), scan = pairs[k]
        robot_x, robot_y, robot_theta = truth.poses[k].tolist()
        assert x == pytest.approx(robot_x - 0.04 * math.cos(robot_theta), abs=3e-4)
        assert y == pytest.approx(robot_y - 0.04 * math.sin(robot_theta), abs=3e-4)
        assert theta == pytest.approx(robot_theta, abs=1e-3)
        assert to_ns(scan.header.stamp) == truth.stamps[k]


def test_raw_log_has_no_posed_scans(write: Write) -> None:
    with pytest.raises(RecordingError, match=r"holds no corrected poses: .* raw odometry"):
        next(posed_scans(write(*drive(3))))


def test_advice_for_a_raw_log_can_be_followed(write: Write) -> None:
    """A replay would need the very map that is wanted."""
    with pytest.raises(RecordingError, match=words_in_order("log", "corrected")) as error:
        next(posed_scans(write(*drive(3))))
    assert "replay" not in str(error.value).removeprefix(str(write()))


def pose_at(stamps: Sequence[int], poses: Array, stamp: int) -> tuple[float, float, float]:
    x, y = (float(np.interp(stamp, stamps, poses[:, k])) for k in (0, 1))
    return x, y, float(np.interp(stamp, stamps, np.unwrap(poses[:, 2])))


@pytest.mark.parametrize(
    ("log", "begin_s", "end_s"),
    sampled(
        [(FR101, 158.5, 170.0), (FR079, 1513.6, 1519.4), (FR079, 2199.4, 2201.4), (FR101, 800, 820)]
    ),
)
def test_odometry_moves_like_the_corrected_poses(log: Path, begin_s: float, end_s: float) -> None:
    """In the first two stretches the robot drives backwards; in the others odometry is reset."""
    recording = CarmenRecording(log)
    odometry, truth = recording.odometry(), recording.truth()
    assert odometry is not None
    assert truth is not None

    steps = [
        relative(*(pose_at(track.stamps, track.poses, round(t * SECOND)) for t in (begin_s, end_s)))
        for track in (odometry, truth)
    ]

    assert distance(*steps) < 0.15 * math.hypot(*steps[1][:2]) + 0.1
    assert wrap(steps[0][2] - steps[1][2]) == pytest.approx(0.0, abs=0.2)
