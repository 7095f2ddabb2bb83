"""Replay components publish any recording at its recorded times, completely or in part."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cairn import SECOND, CairnError, from_ns, to_ns
from cairn.components.replay_devices.carmen import CarmenRecording
from cairn.components.replay_devices.components import (
    ReplayOdometry,
    ReplayRecognizer,
    ReplayScanner,
    ReplayTruth,
)
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.pacing import ReplayClock
from cairn.errors import RecordingError
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.testing.lockstep import ComponentHarness, DeploymentHarness
from tests.components.replay_devices.conftest import FR079, FR101, LEGS, Write, flaser, odom, start
from tests.sweeps import sampled
from tests.wording import words_in_order

pytestmark = pytest.mark.slow


BEGIN = 1211.520329  # fr079's first record [s]


def test_scans_are_published_at_their_recorded_times() -> None:
    scans = CarmenRecording(FR101).scans()
    assert scans is not None
    harness = start(ReplayScanner, 158.0, recording=str(FR101))

    harness.run_for(30.0)

    sent = harness.take("scan")
    assert [to_ns(s.header.stamp) for s in sent] == [
        stamp for stamp in scans.stamps if stamp <= 188 * SECOND
    ]
    assert len(sent) > 5
    assert np.array_equal(sent[3].ranges, scans.messages[3].ranges, equal_nan=True)


def test_bag_without_odometry_replays_its_scans_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    first, _ = open_recording(LEGS).span()
    scanner = start(ReplayScanner, first / SECOND, recording=str(LEGS))
    wheels = start(ReplayOdometry, first / SECOND, recording=str(LEGS))

    scanner.run_for(2.0)
    wheels.run_for(2.0)

    assert 20 <= len(scanner.take("scan")) <= 21
    assert wheels.take("odom") == []
    assert wheels.take("reached")
    assert f"{LEGS} holds no odometry: nothing to replay" in [r.message for r in caplog.records]


def test_laser_recording_has_no_observations(caplog: pytest.LogCaptureFixture) -> None:
    harness = start(ReplayRecognizer, 158.0, recording=str(FR101))

    harness.run_for(1.0)

    assert harness.take("objects") == []
    assert any("holds no observations of landmarks" in r.message for r in caplog.records)


def test_mount_in_a_recording_is_logged(caplog: pytest.LogCaptureFixture, write: Write) -> None:
    with caplog.at_level("INFO"):
        start(ReplayClock, 0.0, recording=str(write(flaser(1.0, 0.0))))

    (text,) = [r.getMessage() for r in caplog.records if "scanner's mount" in r.getMessage()]
    assert "by FLASER records: x 0.100 m, y 0.000 m, theta 0.0000 rad" in text


def test_assumptions_about_a_recording_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    start(ReplayClock, 0.0, recording=str(FR079))

    assert any("of driving backwards as forward" in r.message for r in caplog.records)


def test_corrected_poses_are_replayed_as_truth() -> None:
    truth = CarmenRecording(FR101).truth()
    assert truth is not None
    harness = start(ReplayTruth, 158.0, recording=str(FR101))

    harness.run_for(10.0)

    sent = harness.take("truth")
    assert sent
    assert sent[0].header.frame_id == "map"
    assert sent[0].pose.position.x == pytest.approx(truth.poses[0, 0])
    assert harness.take("true_map") == []


@pytest.mark.parametrize("driver", sampled([ReplayScanner, ReplayOdometry, ReplayTruth]))
def test_part_of_a_recording_is_replayed(driver: Any) -> None:
    port = {ReplayOdometry: "odom", ReplayScanner: "scan", ReplayTruth: "truth"}[driver]
    harness = start(driver, BEGIN + 499.0, recording=str(FR079), begin_s=500.0, end_s=503.0)

    harness.run_for(10.0)

    stamps = [to_ns(m.header.stamp) / SECOND - BEGIN for m in harness.take(port)]
    assert len(stamps) > 3
    assert stamps[0] == pytest.approx(500.2, abs=0.3)
    assert stamps[-1] == pytest.approx(502.8, abs=0.3)


def test_clock_runs_over_the_replayed_part() -> None:
    harness = start(ReplayClock, 50.0, recording=str(FR101), begin_s=100.0, end_s=110.0, rate=10.0)

    harness.run_for(2.0)

    times = [to_ns(m.clock) / SECOND for m in harness.take("time")]
    first = CarmenRecording(FR101).span()[0] / SECOND
    assert times[0] == pytest.approx(first + 100.0)
    assert first + 110.0 < times[-1] < first + 111.2
    assert harness.ends == [ExitReport(True, "the recording is at its end")]


def test_recorded_time_goes_on_where_it_is_when_the_system_clock_is_set_back() -> None:
    class Settable(ReplayClock):
        clock_source = "deployment"  # a clock that the test sets

    harness = ComponentHarness(Settable, {"recording": str(FR101)}, simulated_time=True)
    for time in (100.0, 100.5, 101.5, 102.5, 40.0, 41.0, 42.0):
        harness.publish("clock", Clock(clock=from_ns(round(time * SECOND))))

    times = [to_ns(m.clock) / SECOND for m in harness.take("time")]
    passed = [time - times[0] for time in times]
    assert passed == pytest.approx([0.0, 0.5, 1.5, 2.5, 2.5, 3.5])


def test_part_after_the_end_is_rejected() -> None:
    with pytest.raises(CairnError, match=r"nothing to replay .* the recording is 923.6 s long"):
        start(ReplayScanner, 0.0, recording=str(FR101), begin_s=2000.0)


def test_data_set_of_several_robots_needs_a_robot_number(dataset: Path) -> None:
    with pytest.raises(RecordingError, match=words_in_order("--robot", "`robot`", "2, 5")):
        open_recording(dataset)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89PNG\r\n\x1a\n", "is not a recording that can be read .it starts with b'.x89PNG"),
        (b"hello world\n", "is not a recording that can be read"),
        (b"", "is an empty file"),
        (b"\x1f\x8bcut", "line 1: the compressed stream is broken"),
    ],
)
def test_unknown_file_is_rejected_with_the_known_formats(
    tmp_path: Path, content: bytes, message: str
) -> None:
    path = tmp_path / "thing"
    path.write_bytes(content)

    with pytest.raises(RecordingError, match=message):
        open_recording(path)


def test_missing_recording_and_wrong_folder_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=words_in_order("no such file", "MRCLAM")):
        open_recording(tmp_path / "nowhere")
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(RecordingError, match=r"is not a recording .it holds: notes.txt"):
        open_recording(tmp_path)


def test_robot_of_an_mrclam_data_set_is_asked_for_with_those_that_it_has(tmp_path: Path) -> None:
    for robot in (2, 5):
        (tmp_path / f"Robot{robot}_Odometry.dat").touch()
    with pytest.raises(RecordingError, match=words_in_order("--robot", "it has: 2, 5")):
        open_recording(tmp_path)


def test_complete_replay_in_lockstep_from_time_zero(write: Write, tmp_path: Path) -> None:
    """A log may start at time 0, at which simulated clocks start, too."""
    log = str(write(*(odom(k / 10, k / 10) for k in range(31))))
    page = {
        "cairn": 1,
        "robot": "robot",
        "clock": "simulated",
        "components": {
            "base": {
                "plugin": "components.replay_devices.components:ReplayOdometry",
                "parameters": {"recording": log},
            },
            "clock": {
                "plugin": "components.replay_devices.pacing:ReplayClock",
                "parameters": {"recording": log, "rate": 10.0},
                "topics": {"time": "clock"},
                "significant": True,
                "restart": "transient",
            },
        },
    }
    file = tmp_path / "run.yaml"
    file.write_text(yaml.safe_dump(page, sort_keys=False))

    with DeploymentHarness(file) as replay:
        odometry = replay.read("odom", Odometry)
        assert replay.run_to_end().normal

    stamps = [to_ns(message.header.stamp) for message in odometry.messages]
    assert stamps == [k * SECOND // 10 for k in range(31)]
