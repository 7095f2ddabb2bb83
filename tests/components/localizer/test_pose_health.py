"""The health of the pose: what decides it, and how missing scans limit it."""

import logging

import numpy as np
import pytest

from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.pose_health import ScannerMonitor, assess_health, limit_unconfirmed
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.planar.scans import Rays
from cairn.schemas.cairn_nav_msgs import NO_REASON, Reason, ReasonCode
from tests.wording import assert_words

LOG = logging.getLogger(__name__)
NOTHING = PoseSupport(0, 0)


def pose(spread_m: float = 0.05, heading: float = 0.02) -> PoseEstimate:
    return PoseEstimate((0.0, 0.0, 0.0), np.diag([spread_m**2 / 2, spread_m**2 / 2, heading**2]))


def test_good_pose_has_full_health_and_no_reason() -> None:
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
def test_worst_aspect_decides_and_is_named(
    estimate: PoseEstimate, support: PoseSupport, fit: float | None, word: str
) -> None:
    health = assess_health(estimate, support, fit)

    assert health.value < 0.35
    assert word in health.reason.text


def test_contradicting_objects_weigh_less_while_scans_fit() -> None:
    assert assess_health(pose(), PoseSupport(0, 3), 0.9).value == 0.5
    assert assess_health(pose(), PoseSupport(0, 3), None).value == 0.0


def test_unconfirmed_pose_has_limited_health() -> None:
    well = assess_health(pose(), NOTHING, 0.9)
    ill = assess_health(pose(spread_m=0.55), NOTHING, 0.9)

    assert limit_unconfirmed(well, Reason(ReasonCode.UNCONFIRMED, "why")).value < 0.5
    assert limit_unconfirmed(well, Reason(ReasonCode.UNCONFIRMED, "why")).reason.text == "why"
    assert limit_unconfirmed(ill, Reason(ReasonCode.UNCONFIRMED, "why")) == ill


def rays(hits: int, misses: int, unknown: int) -> Rays:
    ranges = np.repeat([2.0, np.inf, np.nan], [hits, misses, unknown])
    return Rays(np.zeros((ranges.size, 2)), np.zeros(ranges.size), ranges, 10.0)


@pytest.mark.parametrize(
    ("scan", "contradicted", "least", "most", "words"),
    [
        (rays(20, 40, 0), False, 1.0, 1.0, [""]),
        (rays(0, 60, 0), False, 0.5, 0.5, ["no scan", "/scan", "hits", "2.0 s"]),
        (rays(0, 60, 0), True, 0.0, 0.2, ["no valid scan", "/scan", "2.0 s"]),
        (rays(0, 0, 60), False, 0.0, 0.2, ["no valid scan", "/scan", "2.0 s"]),
        (rays(0, 0, 0), False, 0.0, 0.2, ["no valid scan", "/scan", "2.0 s"]),
        (rays(1, 0, 59), False, 0.0, 0.2, ["no valid scan", "/scan", "2.0 s"]),
    ],
)
def test_missing_or_invalid_scans_limit_the_health(
    scan: Rays, contradicted: bool, least: float, most: float, words: list[str]
) -> None:
    well, watch = assess_health(pose(), NOTHING, 0.9), ScannerMonitor()
    watch.add(8.0, rays(60, 0, 0), contradicted=False)

    for tenth in range(20):
        watch.add(8.1 + 0.1 * tenth, scan, contradicted)
    found = watch.limit(well, 10.0, "/scan")

    assert least <= found.value <= most
    assert bool(found.reason.text) == any(words)
    assert_words(found.reason.text, *words)
