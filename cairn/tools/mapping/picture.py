"""Draws a map that was built: its cells, the robot's way, and the loops that were found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn import CairnError
from cairn.components.slam.pose_graph import EdgeKind
from cairn.planar.grid import OCCUPIED_FROM, UNKNOWN, OccupancyCells
from cairn.tools.mapping.build import BuiltMap

_WIDTH = 12.0  # of the picture [in]
_MOST_PIXELS = 1320  # along a side: several cells are one pixel, an obstacle before a free cell
_WAY, _LOOPS = "#1f6fb4", "#d98200"
_UNSEEN, _FREE, _OBSTACLE = 0, 1, 2
_SHADES = ListedColormap(["#d9d9d9", "#ffffff", "#1a1a1a"])


def draw_built_map(built: BuiltMap, title: str, file: Path) -> None:
    """Draw a map to a PNG file; raises `CairnError` if it cannot be written."""
    shape = 0.7
    if built.grid is not None:
        width, height = built.grid.size_m
        shape = height / width
    figure = Figure(figsize=(_WIDTH, max(4.0, _WIDTH * shape + 1.0)), layout="constrained")
    axes = figure.add_subplot()
    if built.grid is not None:
        _draw_grid(axes, built.grid)
    poses, graph = built.poses, built.mapper.graph
    shown = built.mapper.in_map()
    loops = [
        graph.poses[[edge.first, edge.second], :2]
        for edge in graph.edges
        if edge.kind is EdgeKind.CLOSURE and shown[edge.first]
    ]
    axes.add_collection(LineCollection(loops, colors=_LOOPS, linewidths=0.5, alpha=0.5))
    axes.plot(poses[:, 0], poses[:, 1], color=_WAY, linewidth=0.8, label="way of the robot")
    if loops:
        label = "1 loop closed" if len(loops) == 1 else f"{len(loops)} loops closed"
        axes.plot([], [], color=_LOOPS, linewidth=1.0, label=label)
    if len(poses):
        axes.plot(poses[0, 0], poses[0, 1], "o", color="tab:green", label="start")
        axes.plot(poses[-1, 0], poses[-1, 1], "s", color="tab:red", label="end")
    landmarks = built.landmarks.landmarks
    if landmarks:
        x, y = [one.position.x for one in landmarks], [one.position.y for one in landmarks]
        axes.plot(x, y, "*", color="tab:purple", label="landmarks, with object ids")
    for landmark in landmarks:
        at = landmark.position
        axes.annotate(str(landmark.object_id), (at.x, at.y), fontsize=8)
    axes.set_aspect("equal", adjustable="box" if built.grid is not None else "datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(title)
    axes.legend(loc="best", fontsize=8)
    try:
        figure.savefig(file, dpi=110, metadata={"Software": None})
    except OSError as error:
        raise CairnError(f"{file} cannot be written: {error.strerror or error}") from error


def _draw_grid(axes: Axes, grid: OccupancyCells) -> None:
    rank: NDArray[np.uint8] = np.full(grid.values.shape, _FREE, np.uint8)
    rank[grid.values == UNKNOWN] = _UNSEEN
    rank[grid.values >= OCCUPIED_FROM] = _OBSTACLE
    # Matplotlib makes several copies of all pixels; of those with colors, of 32 bytes each.
    size = math.ceil(max(rank.shape) / _MOST_PIXELS)
    rank = np.pad(rank, [(0, -length % size) for length in rank.shape])
    rows, columns = rank.shape
    x, y, _ = grid.frame.origin
    rank = rank.reshape(rows // size, size, columns // size, size).max(axis=(1, 3))
    meters = grid.frame.resolution
    extent = (x, x + columns * meters, y, y + rows * meters)
    axes.imshow(
        rank, _SHADES, vmin=_UNSEEN, vmax=_OBSTACLE, origin="lower", extent=extent,
        interpolation="nearest", interpolation_stage="data",
    )  # fmt: skip
