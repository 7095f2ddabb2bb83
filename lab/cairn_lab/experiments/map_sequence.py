"""The eight maps of figure 10, from a run in which an object was moved: when, and as a picture."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OCCUPIED_FROM, OccupancyCells
from cairn.planar.map_file import read_map
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import ObjectEvidence, VisualMapChange
from cairn_lab.experiments.series import (
    MethodSeries,
    RecordedChange,
    RecordedEvidence,
    RecordedLandmark,
    TrueMove,
    WorldSeries,
)

Array = NDArray[np.float64]
T = TypeVar("T")

# The object of the paper's panels (b) and (c); the first recognized one if it is not recognized.
_PAPER_OBJECT = 7
# Reliability at which (c) is drawn: that after one similarity of 0.9, from 0.5.
_RELIABLE = 0.9 - 1e-6
_NEW_PARTICLES = 300
_COLORS = "RdYlGn"


@dataclass(frozen=True)
class MapPanel:
    """One map: its letter and title, when [s] it was, its landmarks, and the robot's estimate.

    `particles` (n, 2) [m] are new ones around the landmark `object_id`; None if none are drawn. A
    panel whose event did not happen has no stamp.
    """

    letter: str
    title: str
    stamp: float | None = None
    landmarks: tuple[RecordedLandmark, ...] = ()
    robot: Pose | None = None
    object_id: int | None = None
    particles: Array | None = None


def map_panels(series: MethodSeries, world: WorldSeries) -> list[MapPanel]:
    """Return the panels (a) to (h) of a run."""
    return [_with_map(panel, series) for panel in _panels(series, world)]


def draw_map_panels(
    panels: Sequence[MapPanel], world: WorldSeries, grid_file: Path, file: Path
) -> None:
    """Draw the panels as maps, with the landmarks in the color of their reliability."""
    grid = read_map(grid_file)
    width, height = grid.size_m
    figure = Figure(figsize=(16.0, 8.0 * height / width + 1.4), layout="constrained")
    all_axes = figure.subplots(2, 4, sharex=True, sharey=True).ravel()
    for axes, panel in zip(all_axes, panels, strict=True):
        _draw_grid(axes, grid)
        when = "did not happen" if panel.stamp is None else f"{panel.stamp:.1f} s"
        axes.set_title(f"({panel.letter}) {panel.title}\n{when}", fontsize="small")
        if panel.stamp is not None:
            _draw_panel(axes, panel, panel.stamp, world)
    colors = ScalarMappable(Normalize(0.0, 1.0), _COLORS)
    figure.colorbar(colors, ax=all_axes, label="reliability of a landmark", shrink=0.6)
    figure.supxlabel(
        "squares: landmarks in the map; crosses: removed ones; rings: true positions; "
        "dots: new particles; orange: the robot. Meters.",
        fontsize="small",
    )
    figure.savefig(file, dpi=100)


def ring_of_particles(center: tuple[float, float], radius: float, seed: int) -> Array:
    """Return new particles (n, 2) [m] as the paper draws them: at the observed range [m]."""
    random = np.random.default_rng(seed)
    angle = random.uniform(-math.pi, math.pi, _NEW_PARTICLES)
    sigma = 0.02 + 0.01 * radius**2
    distance = radius + sigma * random.standard_normal(_NEW_PARTICLES)
    return np.column_stack(
        (center[0] + distance * np.cos(angle), center[1] + distance * np.sin(angle))
    )


def _panels(series: MethodSeries, world: WorldSeries) -> Iterator[MapPanel]:
    start = series.landmarks[0].stamp if series.landmarks else None
    yield MapPanel("a", "reliabilities at the start", start)
    first = _first_recognized(series)
    yield _new_particles("b", "new particles around object {}, just recognized", series, first)
    yield _reliable(series, first)
    move = world.moves[0] if world.moves else None
    if move is None:
        yield from (MapPanel(letter, "nothing was moved") for letter in "defgh")
        return
    yield MapPanel("d", "all recognized objects are reliable", math.nextafter(move.stamp, 0.0))
    key = move.object_id
    contradiction = _next(
        one
        for one in series.evidence
        if one.object_id == key
        and one.stamp > move.stamp
        and one.verdict == ObjectEvidence.DISAGREES
    )
    title = "object {} is moved: new particles at its old position"
    yield _new_particles("e", title, series, contradiction)
    yield _unreliable(series, move, contradiction)
    removal = _change(series, VisualMapChange.REMOVED, key, move.stamp)
    yield _recognized_again(series, removal)
    since = removal.stamp if removal else math.inf
    registration = _change(series, VisualMapChange.REGISTERED, key, since)
    stamp = registration.stamp if registration else None
    yield MapPanel("h", f"object {key} registered at its new position", stamp)


def _first_recognized(series: MethodSeries) -> RecordedEvidence | None:
    mine = (one for one in series.evidence if one.object_id == _PAPER_OBJECT)
    return _next(mine) or _next(iter(series.evidence))


def _reliable(series: MethodSeries, first: RecordedEvidence | None) -> MapPanel:
    if first is None:
        return MapPanel("c", "nothing was recognized")
    key = first.object_id
    risen = _next(
        one
        for one in series.landmarks
        if one.object_id == key and one.stamp >= first.stamp and one.reliability >= _RELIABLE
    )
    if risen is None:
        return MapPanel("c", f"object {key} becomes reliable")
    title = f"reliability of object {key} rises to {risen.reliability:.2f}"
    return MapPanel("c", title, risen.stamp)


def _unreliable(
    series: MethodSeries, move: TrueMove, contradiction: RecordedEvidence | None
) -> MapPanel:
    before = series.map_at(move.stamp).get(move.object_id)
    since = contradiction.stamp if contradiction else math.inf
    fallen = _next(
        one
        for one in series.landmarks
        if one.object_id == move.object_id
        and one.stamp >= since
        and before is not None
        and one.reliability < min(0.5, before.reliability)
    )
    title = f"reliability of object {move.object_id} falls"
    if fallen is None:
        return MapPanel("f", title)
    return MapPanel("f", f"{title} to {fallen.reliability:.2f}", fallen.stamp)


def _recognized_again(series: MethodSeries, removal: RecordedChange | None) -> MapPanel:
    """Return the panel after the removal, with new particles around the observed position."""
    title = "object {} removed: new particles at its new position"
    if removal is None:
        return MapPanel("g", title.format("moved"))
    mine = [one for one in series.evidence if one.object_id == removal.object_id]
    last = _next(one for one in mine if one.stamp >= removal.stamp)
    title = title.format(removal.object_id)
    if last is None:
        return MapPanel("g", title, removal.stamp)
    particles = ring_of_particles(last.position, last.range_m, 2)
    return MapPanel("g", title, removal.stamp, object_id=removal.object_id, particles=particles)


def _new_particles(
    letter: str, title: str, series: MethodSeries, evidence: RecordedEvidence | None
) -> MapPanel:
    """Return a panel with new particles around the position of a landmark in the map."""
    if evidence is None:
        return MapPanel(letter, title.format("moved"))
    key = evidence.object_id
    landmark = series.map_at(evidence.stamp).get(key)
    particles = ring_of_particles(landmark.position, evidence.range_m, 1) if landmark else None
    return MapPanel(letter, title.format(key), evidence.stamp, object_id=key, particles=particles)


def _with_map(panel: MapPanel, series: MethodSeries) -> MapPanel:
    """Return the panel with the map and the robot's estimate of its time."""
    if panel.stamp is None or not series.stamps.size:
        return panel
    # (b) and (e) show the map before their evidence has changed it.
    stamp = math.nextafter(panel.stamp, 0.0) if panel.letter in "be" else panel.stamp
    index = min(int(np.searchsorted(series.stamps, panel.stamp)), series.stamps.size - 1)
    x, y, theta = series.poses[index].tolist()
    landmarks = tuple(series.map_at(stamp).values())
    return replace(panel, landmarks=landmarks, robot=(x, y, theta))


def _change(series: MethodSeries, kind: int, object_id: int, since: float) -> RecordedChange | None:
    return _next(
        one
        for one in series.changes
        if one.kind == kind and one.object_id == object_id and one.stamp >= since
    )


def _next(items: Iterable[T]) -> T | None:
    return next(iter(items), None)


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


def _draw_panel(axes: Axes, panel: MapPanel, stamp: float, world: WorldSeries) -> None:
    if panel.particles is not None:
        x, y = panel.particles.T
        axes.scatter(x, y, s=2, color="tab:blue", alpha=0.5, zorder=2)
    for x, y in world.positions(stamp).values():
        axes.plot(x, y, "o", markersize=13, markerfacecolor="none", color="gray", zorder=2)
    for one in panel.landmarks:
        marker, color = ("s", "black") if one.live else ("X", "tab:red")
        axes.scatter(
            one.position[0],
            one.position[1],
            s=70,
            marker=marker,
            c=[one.reliability],
            cmap=_COLORS,
            vmin=0.0,
            vmax=1.0,
            edgecolors=color,
            linewidths=1.8 if one.object_id == panel.object_id else 0.6,
            zorder=3,
        )
        axes.annotate(
            f"{one.object_id}: {one.reliability:.2f}",
            one.position,
            (0, 7),
            textcoords="offset points",
            fontsize=6,
            ha="center",
            zorder=4,
        )
    if panel.robot is not None:
        x, y, theta = panel.robot
        axes.plot(x, y, "o", markersize=7, color="tab:orange", zorder=4)
        ahead = (0.5 * math.cos(theta), 0.5 * math.sin(theta))
        axes.arrow(x, y, *ahead, width=0.05, color="tab:orange", zorder=4)
