"""The parameters of the component GraphKeeper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from cairn import Config, FromRobot, Mount, ReadPath


class GraphKeeperConfig(Config):
    """Parameters of the component GraphKeeper."""

    graph_file: ReadPath = Field(
        description="The graph of the map (.graph), which `cairn map build` or the component slam "
        "has written beside the grid map; it stays unchanged.",
    )
    working_copy: Path = Field(
        description="Copy of graph_file that is changed instead of it. An existing copy of the "
        "same graph is used again, in a replay unless it is of a later time.",
    )
    permanent_s: float = Field(
        600.0,
        ge=1,
        le=604_800,
        description="How long the grid map must differ from the graph before scans change the "
        "graph [s].",
    )
    keyframes_per_m2: float = Field(
        4.0,
        ge=0.1,
        le=100,
        description="Most keyframes per known area; with more, changes retire those that the map "
        "needs least. As many retired ones are kept for `cairn map rollback` [1/m²].",
    )
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Field(
        Mount(), description="Pose of the scanner on the robot."
    )
    scans_per_s: float = Field(
        2.0, gt=0, le=100, description="Maximum rate of scans that are considered [1/s]."
    )
    least_health: float = Field(
        0.6, ge=0, le=1, description="Minimum health of the pose of a scan [1]."
    )
    most_spread: float = Field(
        0.15, gt=0, le=1, description="Largest standard deviation of its position [m]."
    )
