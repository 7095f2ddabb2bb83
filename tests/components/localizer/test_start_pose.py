"""The start pose: a localizer continues from the last pose of an earlier one."""

import logging
from pathlib import Path

import numpy as np
import pytest

from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.start_pose import load_last_pose, save_last_pose
from cairn.planar.poses import Pose

LOG = logging.getLogger(__name__)


def pose(spread_m: float = 0.05, heading: float = 0.02) -> PoseEstimate:
    return PoseEstimate((0.0, 0.0, 0.0), np.diag([spread_m**2 / 2, spread_m**2 / 2, heading**2]))


def test_last_pose_is_moved_on_by_odometry(tmp_path: Path) -> None:
    file = tmp_path / "pose.json"
    save_last_pose(file, 100.0, (1.0, 2.0, 0.5), np.diag([1e-4, 1e-4, 1e-4]), (5.0, 5.0, 0.5))

    found = load_last_pose(file, 102.0, (5.0 + np.cos(0.5), 5.0 + np.sin(0.5), 0.5), LOG)

    assert found is not None
    assert found.mean == pytest.approx((1.0 + np.cos(0.5), 2.0 + np.sin(0.5), 0.5))
    assert found.spread < 0.1


def test_restarted_odometry_leaves_the_last_pose(tmp_path: Path) -> None:
    file = tmp_path / "pose.json"
    save_last_pose(file, 100.0, (1.0, 2.0, 0.5), np.diag([1e-4, 1e-4, 1e-4]), (50.0, 5.0, 0.5))

    found = load_last_pose(file, 101.0, (0.0, 0.0, 0.0), LOG)

    assert found is not None
    assert found.mean == pytest.approx((1.0, 2.0, 0.5))
    assert found.spread > 0.3


@pytest.mark.parametrize("now_s", [99.0, 161.0])
def test_last_pose_of_another_time_is_not_used(tmp_path: Path, now_s: float) -> None:
    file = tmp_path / "pose.json"
    where: Pose = (1.0, 2.0, 0.5)
    save_last_pose(file, 100.0, where, np.eye(3), where)

    assert load_last_pose(file, now_s, where, LOG) is None


@pytest.mark.parametrize("text", ["", "{", '{"stamp_s": NaN}', '{"stamp_s": 1.0, "pose": [1]}'])
def test_damaged_pose_file_is_logged_and_not_used(
    tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "pose.json"
    file.write_text(text, encoding="utf-8")

    assert load_last_pose(file, 100.0, (0.0, 0.0, 0.0), LOG) is None
    assert "not used" in caplog.text
    assert load_last_pose(tmp_path / "none.json", 100.0, (0.0, 0.0, 0.0), LOG) is None
