"""Health limits: the defaults fit each other, as docs/concepts/navigation.md says."""

from pathlib import Path

import numpy as np

from cairn.components.automove.component import AutoMoveConfig
from cairn.components.localizer.pose_health import PoseHealth, ScannerMonitor, limit_unconfirmed
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.components.map_builder.config import MapBuilderConfig
from cairn.components.motion_control.config import MotionControlConfig
from cairn.components.path_planner.config import PathPlannerConfig
from cairn.planar.scans import Rays
from cairn.schemas.cairn_nav_msgs import NO_REASON, Reason, ReasonCode

BEST = PoseHealth(1.0, NO_REASON, PoseSupport(0, 0), None)
JUST_FOUND = limit_unconfirmed(BEST, Reason(ReasonCode.UNCONFIRMED, "why")).value


def out_of_reach() -> float:
    """The health of a robot whose scanner reaches nothing."""
    watch, ranges = ScannerMonitor(), np.full(60, np.inf)
    watch.add(2.0, Rays(np.zeros((60, 2)), np.zeros(60), ranges, 10.0), contradicted=False)
    return watch.limit(BEST, 2.0, "scan").value


AUTOMOVE, MOTION = AutoMoveConfig(), MotionControlConfig()


def test_robot_just_found_may_move_but_has_not_arrived() -> None:
    assert MOTION.health_limit + 0.05 <= JUST_FOUND
    assert AUTOMOVE.least_health <= JUST_FOUND < AUTOMOVE.sure_health


def test_robot_whose_scans_hit_nothing_may_arrive() -> None:
    assert AUTOMOVE.sure_health <= out_of_reach()


def test_robot_that_motion_control_stops_is_relocalized() -> None:
    assert MOTION.health_limit <= AUTOMOVE.least_health
    assert PathPlannerConfig().least_health <= MOTION.health_limit


def test_uncertain_poses_do_not_update_the_map() -> None:
    builder = MapBuilderConfig(grid_file=Path("map.yaml"))
    assert max(JUST_FOUND, out_of_reach()) < builder.least_health
