"""How a pose's health is judged, and how a localizer goes on where another ended."""

import logging
from pathlib import Path

import numpy as np
import pytest

from cairn.components.localizer.health import ScannerMonitor, assess_health, limit_unconfirmed
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.components.localizer.start_pose import load_last_pose, save_last_pose
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays
from cairn.schemas.cairn_nav_msgs import NO_REASON, Reason, ReasonCode

LOG = logging.getLogger(__name__)
NOTHING = PoseSupport(0, 0)


def pose(spread_m: float = 0.05, heading: float = 0.02) -> PoseEstimate:
    return PoseEstimate((0.0, 0.0, 0.0), np.diag([spread_m**2 / 2, spread_m**2 / 2, heading**2]))


def test_a_good_pose_has_full_health_and_no_reason() -> None:
    health = assess_health(pose(), PoseSupport(3, 0), 0.9)

    assert (health.value, health.reason) == (1.0, NO_REASON)


@pytest.mark.parametrize(
    ("estimate", "support", "fit", "word"),
    [
        (pose(spread_m=0.5), NOTHING, 0.9, "position is uncertain by 0.50 m"),
        (pose(heading=0.4), NOTHING, 0.9, "heading is uncertain by 0.40 rad"),
        (pose(), NOTHING, 0.3, "map explains 30% of the scan"),
        (pose(), PoseSupport(1, 3), None, "1 agree with the pose and 3 contradict"),
    ],
)
def test_the_worst_side_decides_and_is_named(
    estimate: PoseEstimate, support: PoseSupport, fit: float | None, word: str
) -> None:
    health = assess_health(estimate, support, fit)

    assert health.value < 0.35
    assert word in health.reason.text


def test_objects_that_contradict_weigh_less_where_the_scan_fits() -> None:
    assert assess_health(pose(), PoseSupport(0, 3), 0.9).value == 0.5
    assert assess_health(pose(), PoseSupport(0, 3), None).value == 0.0


def test_what_is_not_sure_is_worth_half_at_most() -> None:
    well = assess_health(pose(), NOTHING, 0.9)
    ill = assess_health(pose(spread_m=0.55), NOTHING, 0.9)

    assert limit_unconfirmed(well, Reason(ReasonCode.UNCONFIRMED, "why")).value < 0.5
    assert limit_unconfirmed(well, Reason(ReasonCode.UNCONFIRMED, "why")).reason.text == "why"
    assert limit_unconfirmed(ill, Reason(ReasonCode.UNCONFIRMED, "why")) == ill


def rays(hits: int, misses: int, unknown: int) -> Rays:
    ranges = np.repeat([2.0, np.inf, np.nan], [hits, misses, unknown])
    return Rays(np.zeros((ranges.size, 2)), np.zeros(ranges.size), ranges, 10.0)


@pytest.mark.parametrize(
    ("seen", "contradicted", "least", "most", "why"),
    [
        (rays(20, 40, 0), False, 1.0, 1.0, ""),
        (rays(0, 60, 0), False, 0.5, 0.5, "no scan on /scan that hits anything for 2.0 s"),
        (rays(0, 60, 0), True, 0.0, 0.2, "no valid scan on /scan for 2.0 s"),
        (rays(0, 0, 60), False, 0.0, 0.2, "no valid scan on /scan for 2.0 s"),
        (rays(0, 0, 0), False, 0.0, 0.2, "no valid scan on /scan for 2.0 s"),
        (rays(1, 0, 59), False, 0.0, 0.2, "no valid scan on /scan for 2.0 s"),
    ],
)
def test_the_less_scans_tell_the_less_the_pose_is_worth(
    seen: Rays, contradicted: bool, least: float, most: float, why: str
) -> None:
    well, watch = assess_health(pose(), NOTHING, 0.9), ScannerMonitor()
    watch.add(8.0, rays(60, 0, 0), contradicted=False)

    for tenth in range(20):
        watch.add(8.1 + 0.1 * tenth, seen, contradicted)
    found = watch.limit(well, 10.0, "/scan")

    assert least <= found.value <= most
    assert found.reason.text == why


def test_the_last_pose_is_carried_on_by_odometry(tmp_path: Path) -> None:
    file = tmp_path / "pose.json"
    save_last_pose(file, 100.0, (1.0, 2.0, 0.5), np.diag([1e-4, 1e-4, 1e-4]), (5.0, 5.0, 0.5))

    found = load_last_pose(file, 102.0, (5.0 + np.cos(0.5), 5.0 + np.sin(0.5), 0.5), LOG)

    assert found is not None
    assert found.mean == pytest.approx((1.0 + np.cos(0.5), 2.0 + np.sin(0.5), 0.5))
    assert found.spread < 0.1


def test_odometry_that_began_anew_leaves_the_robot_where_it_was(tmp_path: Path) -> None:
    file = tmp_path / "pose.json"
    save_last_pose(file, 100.0, (1.0, 2.0, 0.5), np.diag([1e-4, 1e-4, 1e-4]), (50.0, 5.0, 0.5))

    found = load_last_pose(file, 101.0, (0.0, 0.0, 0.0), LOG)

    assert found is not None
    assert found.mean == pytest.approx((1.0, 2.0, 0.5))
    assert found.spread > 0.3


@pytest.mark.parametrize("now_s", [99.0, 161.0])
def test_a_pose_of_another_time_is_not_used(tmp_path: Path, now_s: float) -> None:
    file = tmp_path / "pose.json"
    where: Pose = (1.0, 2.0, 0.5)
    save_last_pose(file, 100.0, where, np.eye(3), where)

    assert load_last_pose(file, now_s, where, LOG) is None


@pytest.mark.parametrize("text", ["", "{", '{"stamp_s": NaN}', '{"stamp_s": 1.0, "pose": [1]}'])
def test_a_damaged_file_is_told_and_not_used(
    tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "pose.json"
    file.write_text(text, encoding="utf-8")

    assert load_last_pose(file, 100.0, (0.0, 0.0, 0.0), LOG) is None
    assert "not used" in caplog.text
    assert load_last_pose(tmp_path / "none.json", 100.0, (0.0, 0.0, 0.0), LOG) is None
