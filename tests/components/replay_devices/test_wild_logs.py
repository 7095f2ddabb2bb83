"""The localizer follows logs with the defects of real loggers, and reports what they are."""

import logging
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn import SECOND, to_ns
from cairn.components.replay_devices.carmen import CarmenRecording
from cairn.components.replay_devices.recording import OdometryStream, ScanStream
from cairn.components.simulation.survey import surveyed_grid
from cairn.planar.map_file import write_map
from cairn.planar.messages import planar_pose
from cairn.planar.odometry import is_jump
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.testing.lockstep import DeploymentHarness
from tests.components.replay_devices.wild_logs import (
    MOUNT,
    NONE,
    OFFICE,
    ORIGIN_S,
    START,
    STEP_S,
    Defects,
    WildLog,
    office_drive,
    wild_log,
)
from tests.sweeps import sampled

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


def streams(tmp_path: Path, log: WildLog) -> tuple[CarmenRecording, OdometryStream, ScanStream]:
    path = tmp_path / "wild.log"
    path.write_text("\n".join(log.lines) + "\n")
    recording = CarmenRecording(path)
    odometry, scans = recording.odometry(), recording.scans()
    assert odometry is not None
    assert scans is not None
    return recording, odometry, scans


@pytest.mark.parametrize("own_clock", sampled([False, True]))
@pytest.mark.parametrize("kind", sampled(["FLASER", "ROBOTLASER1"]))
def test_localizer_follows_a_wild_log_all_the_way(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str, own_clock: bool
) -> None:
    log = wild_log(office_drive(), kind, Defects(own_clock=own_clock))
    path, office = tmp_path / "wild.log", tmp_path / "office.yaml"
    path.write_text("\n".join(log.lines) + "\n")
    write_map(office, surveyed_grid(OFFICE))
    x, y, theta = START
    sets = [
        f"recording.path={path}",
        "recording.scan_delay_s=0",
        f"map={office}",
        f"frames.laser={{x: {MOUNT[0]}, y: {MOUNT[1]}, theta: {MOUNT[2]}}}",
        f"start={{x: {x}, y: {y}, theta: {theta}}}",
        f"report={tmp_path / 'report'}",
    ]
    (tmp_path / "report").mkdir()

    with (
        caplog.at_level(logging.WARNING),
        DeploymentHarness(ROOT / "deploy" / "replay_carmen.yaml", sets=sets, seed=1) as robot,
    ):
        estimates = robot.read("localization", LocalizationEstimate)
        robot.run_to_end()
        found = estimates.take()

    scans = CarmenRecording(path).scans()
    assert scans is not None
    steps = dict(zip(scans.stamps, log.scan_steps, strict=True))
    poses = {to_ns(one.header.stamp): one for one in found if one.located}
    assert set(steps) <= set(poses)  # no scan is dropped
    assert min(one.health for one in poses.values()) >= 0.5  # never lost
    errors = []
    for stamp, step in steps.items():
        x, y, _ = planar_pose(poses[stamp].pose.pose)
        errors.append(math.dist((x, y), office_drive().truth[step, :2]))
    assert max(errors) < 0.1
    warnings = [r.getMessage() for r in caplog.records if r.name.endswith("localizer")]
    assert not [text for text in warnings if not text.startswith("no odometry on")]


@pytest.mark.parametrize("kind", ["FLASER", "ROBOTLASER1"])
def test_odometry_at_a_scan_is_that_of_its_own_record(tmp_path: Path, kind: str) -> None:
    log = wild_log(office_drive(), kind, Defects())

    recording, odometry, scans = streams(tmp_path, log)

    poses = dict(zip(odometry.stamps, odometry.poses.tolist(), strict=True))
    at_scans = np.array([poses[stamp] for stamp in scans.stamps])
    assert at_scans == pytest.approx(office_drive().odometry[log.scan_steps], abs=1e-6)
    assert list(odometry.stamps) == sorted(set(odometry.stamps))
    assert recording.truth() is None  # raw odometry is not a truth


def test_odometry_lines_that_contradict_the_scans_are_left_out_and_counted(tmp_path: Path) -> None:
    recording, odometry, scans = streams(tmp_path, wild_log(office_drive(), "FLASER", Defects()))

    quality = recording.time_quality()["odom"]
    assert 100 < quality.contradicting < 400
    assert any(f"{quality.contradicting} ODOM are left out" in note for note in recording.notes())
    poses = [tuple(pose) for pose in odometry.poses.tolist()]
    for (before, pose), (begin, end) in zip(
        pairwise(poses), pairwise(odometry.stamps), strict=True
    ):
        # With the limits of the localizer.
        assert not is_jump(before, pose, (end - begin) / SECOND, 3.0, 7.0)
    assert _way(odometry.poses) < 1.02 * _way(office_drive().odometry)
    assert len(odometry.stamps) > len(scans.stamps) + 500


def test_bursts_are_spread_and_the_recorded_stamps_kept(tmp_path: Path) -> None:
    log = wild_log(office_drive(), "FLASER", Defects(bad_lines=False, repeated=0.0))

    recording, _, scans = streams(tmp_path, log)

    true = ORIGIN_S + STEP_S * np.array(log.scan_steps)
    late = np.abs(np.array(scans.recorded_stamps) / SECOND - true)
    repaired = np.abs(np.array(scans.stamps) / SECOND - true)
    assert late.max() > 0.8
    assert repaired.max() < 0.2
    assert np.diff(scans.stamps).min() > 0.05 * SECOND
    words = [line.split() for line in log.lines if line.startswith("FLASER")]
    written = [word[-3].replace(".", "") + "000" for word in words]
    assert [str(stamp) for stamp in scans.recorded_stamps] == written
    assert [to_ns(scan.header.stamp) for scan in scans.messages] == list(scans.stamps)
    quality = recording.time_quality()["scan"]
    assert quality.bursts == 40
    assert quality.retimed >= 40
    assert 2.0 < quality.longest_gap_s < 2.5


def test_bursts_are_found_if_most_scans_are_in_them(tmp_path: Path) -> None:
    defects = Defects(stall_every_s=3.0, stall_s=1.6, bad_lines=False)
    log = wild_log(office_drive(), "FLASER", defects)

    recording, odometry, scans = streams(tmp_path, log)

    true = ORIGIN_S + STEP_S * np.array(log.scan_steps)
    assert recording.time_quality()["scan"].bursts > 0.45 * len(log.scan_steps)
    assert np.abs(np.array(scans.stamps) / SECOND - true).max() < 0.2
    assert _way(odometry.poses) < 1.02 * _way(office_drive().odometry)


def test_logger_with_an_even_clock_gives_the_times_of_scans(tmp_path: Path) -> None:
    log = wild_log(office_drive(), "FLASER", Defects(own_clock=True))

    _, _, scans = streams(tmp_path, log)

    true = ORIGIN_S + STEP_S * np.array(log.scan_steps)
    assert np.abs(np.array(scans.stamps) / SECOND - true).max() < 0.01


def test_log_without_poses_at_scans_has_its_odometry_in_the_order_of_the_file(
    tmp_path: Path,
) -> None:
    _, odometry, _ = streams(tmp_path, wild_log(office_drive(), "RAWLASER1", Defects()))

    assert _way(odometry.poses) < 1.02 * _way(office_drive().odometry)
    assert np.diff(odometry.stamps).min() > 0


def test_times_of_a_clean_log_stay_as_they_are(tmp_path: Path) -> None:
    log = wild_log(office_drive(), "FLASER", NONE)

    recording, odometry, scans = streams(tmp_path, log)

    assert list(recording.notes()) == []
    assert scans.stamps == scans.recorded_stamps
    qualities = recording.time_quality().values()
    assert [(one.retimed, one.duplicates, one.contradicting) for one in qualities] == [
        (0, 0, 0)
    ] * 2
    # An ODOM line beside a scan adds nothing to the scan's own pose.
    assert len(odometry.stamps) == round(len(office_drive().truth) / 2 + 0.5)


def _way(poses: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
