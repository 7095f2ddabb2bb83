"""The parameters of the path planner."""

from __future__ import annotations

from pydantic import Field

from cairn import Config, Mount
from cairn.components.path_planner.cost_map import Costs


class PathPlannerConfig(Config):
    """Parameters of the path planner; all may be changed while it runs."""

    radius: float = Field(0.22, gt=0, le=5, description="Radius of the robot [m].")
    margin: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Space around the robot that a way must have: motion control's `margin` [m].",
    )
    reach: float = Field(
        0.45,
        ge=0,
        le=5,
        description="How far beyond the margin obstacles make the way dearer [m].",
    )
    weight: float = Field(
        1.0,
        ge=0,
        le=10,
        description="How much dearer the way is right beside an obstacle, per length [1]; 0: the "
        "shortest path.",
    )
    allow_unknown: bool = Field(
        False, description="Whether paths may lead through cells that nobody has seen."
    )
    step: float = Field(0.1, ge=0.02, le=1, description="Distance of a path's poses [m].")
    mount: Mount = Mount()
    obstacle_memory_s: float = Field(
        3.0,
        ge=0,
        le=60,
        description="How long what the scanner saw is an obstacle, unless seen empty [s]; 0: plan "
        "by the map alone.",
    )
    avoided_s: float = Field(
        60.0,
        ge=0,
        le=600,
        description="How long a way on which the robot did not get on is avoided, if there is "
        "another: where motion control stood blocked, and what the scanner saw there [s].",
    )
    obstacle_range: float = Field(
        3.0, gt=0, le=100, description="How far off the scanner's obstacles count [m]."
    )
    least_health: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Localization health below which the scanner's obstacles are not placed [1].",
    )
    off_path: float = Field(
        0.5, gt=0, le=10, description="Distance from the path that makes a new one due [m]."
    )
    replan_s: float = Field(
        1.0,
        ge=0.5,
        le=60,
        description="Time between looks for a better path, or for one where there is none [s].",
    )
    check_hz: float = Field(
        5.0, gt=0, le=50, description="How often scans are looked at, at most [Hz]."
    )
    gain: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Share of the way left that another path must save to be taken [1].",
    )

    def costs(self) -> Costs:
        """The parameters that make a map's cells dear."""
        return Costs(
            radius=self.radius,
            reach=self.reach,
            weight=self.weight,
            margin=self.margin,
            allow_unknown=self.allow_unknown,
        )
