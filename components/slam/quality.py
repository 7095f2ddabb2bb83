"""Figures that indicate how good a map is, without knowing the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.pose_graph import EdgeKind


@dataclass(frozen=True)
class MapQuality:
    """The quality of a map.

    Attributes:
        scans: number of scans with a pose.
        left_out: number of scans on islands that are not joined to the map.
        keyframes: number of scans that the map is drawn from.
        driven_m: length of the trajectory [m].
        fit: how well scans fit where they were taken, from 0 to 1: the last usual value.
        loops: number of loop closures.
        loops_rejected: number of matches of places that were refused: ambiguous, contradicted by
            free space or by other closures, or not confirmed.
        loop_error_m: root mean square of the closures' errors after the optimization [m].
        loop_error_deg: the same of their headings [deg].
        on_walls: share of what the scanner measured that lies on obstacles of the grid map, from 0
            to 1; 0 without scans.

    """

    scans: int
    left_out: int
    keyframes: int
    driven_m: float
    fit: float
    loops: int
    loops_rejected: int
    loop_error_m: float
    loop_error_deg: float
    on_walls: float


def quality_of(mapper: Mapper, grid: MapGrid) -> MapQuality:
    """Return the quality of a map that is finished and drawn."""
    poses = mapper.poses()
    closures = np.array([edge.kind is EdgeKind.CLOSURE for edge in mapper.graph.edges], bool)
    errors = mapper.graph.errors()[closures] if closures.any() else np.zeros((0, 3))
    counts = mapper.closer.counts
    known = ~np.isnan(poses[:, 0])
    steps = np.diff(poses[known, :2], axis=0)
    return MapQuality(
        scans=int(known.sum()),
        left_out=int((~known).sum()),
        keyframes=int(mapper.in_map().sum()),
        driven_m=float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        fit=mapper.tracker.usual_fit,
        loops=int(closures.sum()),
        loops_rejected=counts.ambiguous
        + counts.misaligned
        + counts.conflicting
        + counts.unconfirmed
        + mapper.graph.rejected,
        loop_error_m=_rms(errors[:, :2]) * 2**0.5,
        loop_error_deg=float(np.degrees(_rms(errors[:, 2:]))),
        on_walls=grid.counts.on_obstacles(),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
