"""The parameters of the component Slam."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from cairn import Config, FromRobot, Mount, ReadPath


class SlamConfig(Config):
    """Parameters of the component Slam."""

    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Field(
        Mount(), description="Pose of the scanner on the robot."
    )
    map_file: Path = Field(
        description="The grid map that is written (YAML, with a PGM beside it), and beside it the "
        "graph (.graph), from which a restarted component continues. A new run keeps the graph of "
        "the run before as NAME.before.graph.",
    )
    extend: ReadPath | None = Field(
        None,
        description="Graph of an earlier map (.graph) that is extended; it stays unchanged. None: "
        "start a new map.",
    )
    resolution: float = Field(0.05, ge=0.01, le=1, description="Size of the map's cells [m].")
    reach: float = Field(
        20.0, ge=0.5, le=200, description="Longer rays only show free space, up to here [m]."
    )
