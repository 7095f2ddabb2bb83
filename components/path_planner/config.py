"""The parameters of the path planner."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from cairn import Config, FromRobot, Mount
from cairn.components.path_planner.cost_map import CostParameters


class PathPlannerConfig(Config):
    """Parameters of the path planner; all may change at run time."""

    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22, gt=0, le=5, description="Radius of the robot [m]."
    )
    margin: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Free space that paths keep around the robot: motion control's `margin` [m].",
    )
    inflation_distance: float = Field(
        0.45,
        ge=0,
        le=5,
        description="Distance beyond the margin over which obstacles make cells more expensive "
        "[m].",
    )
    inflation_weight: float = Field(
        1.0,
        ge=0,
        le=10,
        description="Additional cost per length right beside an obstacle [1]; 0: the shortest "
        "path.",
    )
    allow_unknown: bool = Field(False, description="Whether paths may lead through unknown cells.")
    step: float = Field(0.1, ge=0.02, le=1, description="Distance between the poses of a path [m].")
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Mount()
    obstacle_memory_s: float = Field(
        3.0,
        ge=0,
        le=60,
        description="How long obstacles of the scanner count unless they are seen to be gone "
        "[s]; 0: plan"
        " by the map alone.",
    )
    avoided_s: float = Field(
        60.0,
        ge=0,
        le=600,
        description="How long the planner avoids positions where the robot got stuck, and "
        "remembers "
        "obstacles that forced a detour [s].",
    )
    obstacle_range: float = Field(
        3.0,
        gt=0,
        le=100,
        description="Largest distance at which obstacles of the scanner count [m].",
    )
    least_health: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Least localization health with which obstacles of the scanner are used [1].",
    )
    off_path: float = Field(
        0.5, gt=0, le=10, description="Distance from the path at which the planner replans [m]."
    )
    replan_s: float = Field(
        1.0,
        ge=0.5,
        le=60,
        description="Period of looking for a better path, or for a path if there is none [s].",
    )
    check_hz: float = Field(
        5.0, gt=0, le=50, description="Maximum rate of checking scans against the path [Hz]."
    )
    gain: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Share of the remaining cost and length that another path must save [1].",
    )

    in_keepout: Literal["leave", "stop"] = Field(
        "leave",
        description="What a robot with a goal does in a keepout zone: `leave` by the shortest way, "
        "or `stop` and report it until the zone is changed or an operator drives it out.",
    )
    speed: Annotated[float, FromRobot("limits.speed_m_s")] = Field(
        0.6,
        gt=0,
        le=3,
        description="Speed outside slow zones: motion control's `speed` [m/s]. Paths avoid slow "
        "zones if the way around takes less time.",
    )
    off_lane: float = Field(
        1.5,
        ge=1,
        le=4,
        description="Cost per length outside the lanes of a map that has lanes, relative to that "
        "on a lane [1].",
    )

    def costs(self) -> CostParameters:
        """Return the parameters of the cost map."""
        return CostParameters(
            radius=self.radius,
            inflation_distance=self.inflation_distance,
            inflation_weight=self.inflation_weight,
            margin=self.margin,
            allow_unknown=self.allow_unknown,
            speed=self.speed,
            off_lane=self.off_lane,
        )
