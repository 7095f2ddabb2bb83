"""Inconsistent parameters are rejected, also those that do not fit the path planner's."""

from collections.abc import Mapping

import pytest
from pydantic import ValidationError

from cairn import Config
from cairn.components.motion_control.component import MotionControl
from cairn.components.motion_control.config import MotionControlConfig
from cairn.components.path_planner.config import PathPlannerConfig
from tests.wording import assert_words

Neighbors = Mapping[str, Mapping[str, Config]]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        (
            {"speed": 0.1},
            ("creep_speed 0.15", "speed 0.1", "lower creep_speed to 0.1", "raise speed"),
        ),
        (
            {"acceleration": 0.5},
            ("braking 0.6", "acceleration 0.5", "lower braking to 0.5", "raise acceleration"),
        ),
        (
            {"turn_braking": 4.0},
            ("turn_braking 4", "turn_acceleration 3", "lower turn_braking to 3", "raise"),
        ),
        (
            {"margin": 0.2},
            ("full_speed_clearance 0.2", "margin 0.2", "raise", "lower margin"),
        ),
    ],
)
def test_inconsistent_values_are_rejected_with_the_remedy(
    parameters: dict[str, float], words: tuple[str, ...]
) -> None:
    with pytest.raises(ValidationError) as refused:
        MotionControlConfig.model_validate(parameters)

    assert_words(str(refused.value), *words)


def test_values_at_their_bounds_are_accepted() -> None:
    config = MotionControlConfig(speed=0.15, acceleration=0.6, turn_braking=3.0)

    limits = config.limits()

    assert (limits.creep_speed, limits.braking, limits.turn_braking) == (0.15, 0.6, 3.0)


def test_robot_too_large_for_the_scan_memory_is_rejected() -> None:
    with pytest.raises(ValidationError, match="less than or equal to 1"):
        MotionControlConfig(radius=1.1)


@pytest.mark.parametrize(("key", "own", "planned"), [("speed", 0.4, 0.6), ("margin", 0.08, 0.05)])
def test_check_compares_parameters_with_the_path_planner(
    key: str, own: float, planned: float
) -> None:
    neighbors: Neighbors = {
        "zones": {"map_builder": Config()},
        "plan": {"planner": PathPlannerConfig()},
    }
    wrong = MotionControlConfig.model_validate({key: own})

    ((parameter, found, remedy),) = MotionControl.check_neighbors(wrong, neighbors)

    assert parameter == key
    assert_words(found, f"{own:g} is not {key} {planned:g} of planner")
    assert_words(remedy, f"set {key} of planner to {own:g}", f"this one to {planned:g}")
    assert list(MotionControl.check_neighbors(MotionControlConfig(), neighbors)) == []


def test_speed_of_the_path_planner_does_not_matter_without_zones() -> None:
    neighbors: Neighbors = {"zones": {}, "plan": {"planner": PathPlannerConfig()}}
    assert list(MotionControl.check_neighbors(MotionControlConfig(speed=0.4), neighbors)) == []
