"""The parameters of the map builder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from cairn import Config, FromRobot, Mount, ReadPath
from cairn.components.map_builder.landmark_map import MOST_LEARNED


class MapBuilderConfig(Config):
    """Parameters of the map builder."""

    map_file: ReadPath | None = Field(
        None,
        description="The visual map, a file that `cairn map import` writes; null: no visual map.",
    )
    working_copy: Path | None = Field(
        None,
        description="Copy of map_file that is changed instead of it; none: map_file itself is "
        "changed. An existing copy of the same map is used again, in a replay unless it is of a "
        "later time.",
    )
    learn_unknown: bool = Field(
        True, description="Whether to register objects that are observed but not in the map."
    )
    max_landmarks: int = Field(
        MOST_LEARNED,
        ge=1,
        le=10_000,
        description="Landmarks in the map from which on no further ones are learned.",
    )
    update_objects: bool = Field(True, description="Whether evidence changes the visual map.")
    share: bool = Field(
        False,
        description="Whether to exchange with other robots what is found out: about the landmarks "
        "(ports shared and others, on one topic) and about the cells of the grid map (ports "
        "shared_cells and others_cells, on another). Requires working_copy and grid_copy.",
    )
    grid_file: ReadPath | None = Field(
        None, description="The grid map, a map_server YAML file; none: no grid map."
    )
    grid_copy: Path | None = Field(
        None,
        description="File of the changed grid map (YAML); grid_file is never changed. An existing "
        "copy of the same map is used again, in a replay unless it is of a later time. None: keep "
        "it in memory.",
    )
    update_grid: bool = Field(True, description="Whether scans change the grid map.")
    zones_file: Path | None = Field(
        None,
        description="The zones on the map, a GeoJSON file; usually MAP.zones.geojson beside the "
        "map MAP.yaml. It is written with each change; one that does not exist has no zones. "
        "none: no zones.",
    )
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Field(
        Mount(), description="Pose of the scanner on the robot."
    )
    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22,
        gt=0,
        le=2,
        description="Radius of the robot [m]; with share, other robots keep it out of their maps.",
    )
    scans_per_s: float = Field(
        5.0,
        gt=0,
        le=100,
        description="Maximum rate of scans that are integrated into the grid map [1/s].",
    )
    settle_s: float = Field(
        8.0,
        ge=0,
        le=3600,
        description="How long an obstacle must stand to be added to the grid map [s].",
    )
    undo_s: float = Field(
        60.0,
        ge=0,
        le=120,
        description="Longest time for which changes of the maps are undone after the robot was "
        "lost [s].",
    )
    least_health: float = Field(
        0.6, ge=0, le=1, description="Minimum health of the pose for integrating scans [1]."
    )
    most_spread: float = Field(
        0.15,
        gt=0,
        le=1,
        description="Largest standard deviation of the position for integrating scans [m].",
    )

    @model_validator(mode="after")
    def _check_map_given(self) -> MapBuilderConfig:
        if self.map_file is None and self.grid_file is None:
            raise ValueError("neither map_file nor grid_file is set; set one of them, or both")
        unsafe = [
            f"{map_} and {copy}"
            for map_, copy in (("map_file", "working_copy"), ("grid_file", "grid_copy"))
            if getattr(self, map_) is not None and getattr(self, copy) is None
        ]
        if self.share and unsafe:
            raise ValueError(
                f"share requires {' and '.join(unsafe)}: robots share what differs from the map "
                "from which all of them started, which must stay as it is"
            )
        if self.share and self.map_file is not None and not self.update_objects:
            raise ValueError("share requires update_objects: true; there is nothing else to share")
        return self
