"""Fixture of the path planner's tests: a planner on the bus with a map and a pose."""

from collections.abc import Callable
from typing import Any

import pytest

from cairn.components.path_planner.component import PathPlanner
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose
from tests.components.path_planner.planner_on_the_bus import BEGIN, HERE
from tests.components.path_planner.rooms import as_map, pose_at


@pytest.fixture
def start_planner(stage: Callable[..., Any]) -> Callable[..., Any]:
    def begin(grid: OccupancyCells | None, pose: Pose | None = HERE, **parameters: Any) -> Any:
        it = stage(PathPlanner, BEGIN, **parameters).begin()
        if grid is not None:
            it.give("map", as_map(grid))
        if pose is not None:
            it.give("localization", pose_at(pose, BEGIN))
        return it

    return begin
