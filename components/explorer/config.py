"""The parameters of the component Explorer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cairn import Config, FromRobot


class ExplorerConfig(Config):
    """Parameters of the component Explorer."""

    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22, gt=0, le=5, description="Radius of the robot [m]."
    )
    margin: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Free space that paths keep around the robot: the path planner's `margin` [m].",
    )
    explore: Literal["on_request", "on_activation"] = Field(
        "on_request", description="When exploration starts: with the request `explore`, or at once."
    )
    finish: bool = Field(
        False,
        description="Whether the component ends with the exploration, and, if it is significant, "
        "the deployment with it.",
    )
    state_file: Path | None = Field(
        None,
        description="File that marks an exploration under way, which a restarted explorer "
        "continues. None: the exploration ends with the process.",
    )
