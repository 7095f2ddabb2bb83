"""The parameters of the map builder."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, model_validator

from cairn import Config, Mount, ReadPath
from cairn.components.map_builder.rules import RuleName


class MapBuilderConfig(Config):
    """Parameters of the map builder."""

    map_file: ReadPath | None = Field(
        None, description="The visual map: a file made by `cairn map import`; none: no visual map."
    )
    working_copy: Path | None = Field(
        None,
        description="Where to keep a copy that is changed instead of map_file; none: change "
        "map_file itself. A copy of the same map, not later than now, is gone on with.",
    )
    learn_unknown: bool = Field(
        True, description="Whether to place objects that are sighted but not in the map."
    )
    update_objects: bool = Field(True, description="Whether evidence changes the visual map.")
    rule: RuleName = Field(
        "reliability",
        description="How evidence changes it: by pose reliability; to compare with: the paper's "
        "rule to the letter, or a persistence filter.",
    )
    grid_file: ReadPath | None = Field(
        None, description="The grid map: a map_server YAML file; none: no grid map."
    )
    grid_copy: Path | None = Field(
        None,
        description="Where to keep the changed grid map (YAML); grid_file is never changed. A copy "
        "of the same map, not later than now, is gone on with. None: keep it in memory.",
    )
    update_grid: bool = Field(True, description="Whether scans change the grid map.")
    mount: Mount = Field(Mount(), description="Where the scanner sits on the robot.")
    scans_per_s: float = Field(
        5.0, gt=0, le=100, description="Scans that are put into the grid map, at most [1/s]."
    )
    settle_s: float = Field(
        8.0,
        ge=0,
        le=3600,
        description="How long an obstacle must stand to get into the grid map [s].",
    )
    undo_s: float = Field(
        60.0,
        ge=0,
        le=120,
        description="How far back, at most, changes of the maps are undone when the robot was "
        "lost [s].",
    )
    least_health: float = Field(
        0.6, ge=0, le=1, description="Health of the pose from which scans are put in [1]."
    )
    most_spread: float = Field(
        0.15, gt=0, le=1, description="Position deviation up to which scans are put in [m]."
    )

    @model_validator(mode="after")
    def _something_to_keep(self) -> MapBuilderConfig:
        if self.map_file is None and self.grid_file is None:
            raise ValueError("give map_file, grid_file, or both: there is no map to keep")
        return self
