"""Pictures of the map's repair: the maps (a) to (h) of figure 10, and reliabilities over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OCCUPIED_FROM, OccupancyCells
from cairn.planar.map_file import read_map
from cairn.tools.experiments.sequence import Moment
from cairn.tools.experiments.series import PairSeries, WorldSeries

Array = NDArray[np.float64]

_COLORS = "RdYlGn"
_STEP_S = 0.5


def draw_sequence(
    sequence: Sequence[Moment], world: WorldSeries, grid_file: Path, file: Path
) -> None:
    """The moments as maps, with the objects in the color of their reliability."""
    grid = read_map(grid_file)
    width, height = grid.size_m
    figure = Figure(figsize=(16.0, 8.0 * height / width + 1.4), layout="constrained")
    panels = figure.subplots(2, 4, sharex=True, sharey=True).ravel()
    for axes, moment in zip(panels, sequence, strict=True):
        _draw_grid(axes, grid)
        when = "did not come" if moment.stamp is None else f"{moment.stamp:.1f} s"
        axes.set_title(f"({moment.letter}) {moment.title}\n{when}", fontsize="small")
        if moment.stamp is not None:
            _draw_moment(axes, moment, world)
    colors = ScalarMappable(Normalize(0.0, 1.0), _COLORS)
    figure.colorbar(colors, ax=panels, label="reliability of an object", shrink=0.6)
    figure.supxlabel(
        "squares: objects where the map has them; crosses: removed; rings: where they truly are; "
        "dots: new samples; orange: the robot. Meters.",
        fontsize="small",
    )
    figure.savefig(file, dpi=100)


def draw_reliabilities(runs: Sequence[tuple[PairSeries, WorldSeries]], file: Path) -> None:
    """Reliability over time: of the objects that are moved, and of the others, mean of all runs."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots()
    end = min(float(world.stamps[-1]) for _, world in runs)
    stamps = np.arange(0.0, end, _STEP_S)
    groups: dict[bool, list[Array]] = {True: [], False: []}
    for pair, world in runs:
        moved = {move.object_id for move in world.moves}
        for key in pair.map_at(math.inf):
            groups[key in moved].append(_reliability(pair, key, stamps))
    for is_moved, label, color in (
        (False, "objects that stay", "tab:green"),
        (True, "objects that are moved", "tab:red"),
    ):
        if not groups[is_moved]:
            continue
        rows = np.array(groups[is_moved])
        low, high = np.percentile(rows, [5, 95], axis=0)
        axes.plot(stamps, rows.mean(axis=0), color=color, label=f"{label}: mean, 5 to 95 %")
        axes.fill_between(stamps, low, high, color=color, alpha=0.15, linewidth=0)
    for stamp in {move.stamp for _, world in runs for move in world.moves}:
        axes.axvline(stamp, color="black", linewidth=0.8)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("time [s]; line: an object is moved")
    axes.set_ylabel("reliability [1]")
    axes.legend(loc="lower left", frameon=False)
    figure.savefig(file, dpi=110)


def _reliability(pair: PairSeries, object_id: int, stamps: Array) -> Array:
    mine = [one for one in pair.mapped if one.object_id == object_id]
    since = np.array([one.stamp for one in mine])
    values = np.array([one.reliability for one in mine])
    return np.asarray(values[np.maximum(np.searchsorted(since, stamps, "right") - 1, 0)])


def _draw_grid(axes: Axes, grid: OccupancyCells) -> None:
    picture = np.full(grid.values.shape, 235, np.uint8)
    picture[(grid.values >= 0) & (grid.values <= FREE_TO)] = 255
    picture[grid.values >= OCCUPIED_FROM] = 110
    x, y, _ = grid.frame.origin
    width, height = grid.size_m
    extent = (x, x + width, y, y + height)
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255, origin="lower", extent=extent)
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])


def _draw_moment(axes: Axes, moment: Moment, world: WorldSeries) -> None:
    assert moment.stamp is not None  # or there is nothing to draw
    if moment.samples is not None:
        axes.scatter(
            moment.samples[:, 0], moment.samples[:, 1], s=2, color="tab:blue", alpha=0.5, zorder=2
        )
    for x, y in world.places(moment.stamp).values():
        axes.plot(x, y, "o", markersize=13, markerfacecolor="none", color="gray", zorder=2)
    for one in moment.objects:
        marker, color = ("s", "black") if one.live else ("X", "tab:red")
        axes.scatter(
            one.place[0],
            one.place[1],
            s=70,
            marker=marker,
            c=[one.reliability],
            cmap=_COLORS,
            vmin=0.0,
            vmax=1.0,
            edgecolors=color,
            linewidths=1.8 if one.object_id == moment.of else 0.6,
            zorder=3,
        )
        label = f"{one.object_id}: {one.reliability:.2f}"
        axes.annotate(
            label, one.place, (0, 7), textcoords="offset points", fontsize=6, ha="center", zorder=4
        )
    if moment.robot is not None:
        x, y, theta = moment.robot
        axes.plot(x, y, "o", markersize=7, color="tab:orange", zorder=4)
        ahead = (0.5 * math.cos(theta), 0.5 * math.sin(theta))
        axes.arrow(x, y, *ahead, width=0.05, color="tab:orange", zorder=4)
