"""Trajectory files hold every pose with its time, whatever happens to the report or the disk."""

import errno
from pathlib import Path

import pytest

from cairn import SECOND, RetriedSave, from_ns
from cairn.components.run_outputs import trajectory
from cairn.components.run_outputs.report import Report
from cairn.components.run_outputs.trajectory import TrajectoryFile
from cairn.planar.messages import pose_message
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.geometry_msgs import PoseStamped, PoseWithCovariance
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.disk import room_for

BEGIN = 1_700_000_000 * SECOND
POSE = pose_message((1.0, 0.1, 0.0))
LINES = [
    "# timestamp tx ty tz qx qy qz qw",
    "1700000000.000000001 1.0 0.1 0.0 0.0 0.0 0.0 1.0",
    "1700000001.000000001 1.0 0.1 0.0 0.0 0.0 0.0 1.0",
]


class Owner:
    """The component of the trajectories of a test."""

    def __init__(self, file: Path) -> None:
        self.harness = ComponentHarness(Report, {}, start_s=1000.0)
        self.file = file

    def open(self, *, resume: bool = False) -> TrajectoryFile:
        saved = RetriedSave(self.harness.component, "report's trajectory")
        return TrajectoryFile(self.file, saved, resume=resume)


@pytest.fixture
def owner(tmp_path: Path) -> Owner:
    return Owner(tmp_path / "trajectory.tum")


def test_report_writes_located_estimates_and_true_poses_with_exact_stamps(tmp_path: Path) -> None:
    (tmp_path / "trajectory.tum").write_text("of an earlier run\n")
    report = ComponentHarness(Report, {"directory": str(tmp_path)}, start_s=1000.0)
    for k in range(2):
        header = Header(stamp=from_ns(BEGIN + k * SECOND + 1))
        located = LocalizationEstimate(
            header=header, located=k == 1, pose=PoseWithCovariance(pose=POSE)
        )
        report.publish("localization", located)
        report.publish("truth", PoseStamped(header=header, pose=POSE))
    report.run_for(0.2)

    assert (tmp_path / "trajectory.tum").read_text().splitlines() == [LINES[0], LINES[2]]
    assert (tmp_path / "truth.tum").read_text().splitlines() == LINES


def test_restarted_report_continues_a_trajectory_without_a_half_line(owner: Owner) -> None:
    first = owner.open()
    first.add(BEGIN + 1, POSE)
    with owner.file.open("a") as stream:
        stream.write("1700000001.0")  # killed while it wrote

    owner.open(resume=True).add(BEGIN + SECOND + 1, POSE)

    assert owner.file.read_text().splitlines() == LINES


def test_a_trajectory_of_an_earlier_run_is_replaced_when_its_disk_can_be_written_again(
    owner: Owner, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(file: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, "read-only")

    owner.file.write_text(f"{LINES[0]}\n{LINES[1]}\n")
    with monkeypatch.context() as context:
        context.setattr(Path, "unlink", read_only)
        track = owner.open()

    track.add(BEGIN + SECOND + 1, POSE)

    assert owner.file.read_text().splitlines() == [LINES[0], LINES[2]]


def test_full_disk_delays_a_trajectory_and_loses_nothing(
    owner: Owner, caplog: pytest.LogCaptureFixture
) -> None:
    track = owner.open()
    track.add(BEGIN + 1, POSE)
    with room_for(owner.file.stat().st_size + 20):
        track.add(BEGIN + SECOND + 1, POSE)
        assert owner.file.read_text().splitlines() == LINES[:2]
    assert "1 poses are missing in trajectory.tum" in caplog.text

    track.close()

    assert owner.file.read_text().splitlines() == LINES


def test_poses_that_wait_for_the_disk_are_bounded_and_counted(
    owner: Owner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trajectory, "WAITING_BYTES", 60)
    track = owner.open()
    with room_for(0):
        assert [track.add(BEGIN + 1, POSE) for _ in range(3)] == [True, False, False]

    track.close()

    assert track.omitted == 2
    assert owner.file.read_text().splitlines() == LINES[:2]
