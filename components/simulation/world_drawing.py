"""Draw a world file as a plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from cairn.components.simulation.layout import corners_of
from cairn.components.simulation.world_file import WorldFile

_COLORS = {"plain": "tab:gray", "dark": "black", "glass": "tab:cyan"}
_WIDTH_IN, _LABEL_PT, _ARROW_M = 9.0, 7.0, 0.35


def draw_world(world: WorldFile, radius: float, file: Path) -> None:
    """Draw walls, furniture, objects with directions, people's routes, and the robot's start."""
    points = np.array([point for wall in world.walls for point in wall.points])
    (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
    width, height = right - left, top - bottom
    figure = Figure(figsize=(_WIDTH_IN, max(3.0, _WIDTH_IN * height / width)), layout="constrained")
    axes = figure.add_subplot()
    for wall in world.walls:
        xs, ys = zip(*wall.points, strict=True)
        axes.plot(xs, ys, color=_COLORS[wall.surface], linewidth=2)
    for piece in world.furniture:
        color = _COLORS[piece.surface]
        axes.add_patch(Polygon(corners_of(piece), facecolor=color, alpha=0.4, edgecolor=color))
    for name, (x, y) in label_positions(world, (width + 1.0) / _WIDTH_IN).items():
        axes.text(x, y, name, ha="center", va="center", fontsize=_LABEL_PT)
    for thing in world.objects:
        _arrow(axes, thing.pose, _ARROW_M, "tab:red")
        axes.text(thing.x, thing.y, f"  {thing.id}", color="tab:red", fontsize=8)
    for person in world.people:
        xs, ys = zip(*person.waypoints, person.waypoints[0], strict=True)
        axes.plot(xs, ys, ":", color="tab:green", linewidth=0.8)
        axes.text(*person.waypoints[0], person.name, color="tab:green", fontsize=7)
    axes.add_patch(Circle((world.robot.x, world.robot.y), radius, color="tab:blue", alpha=0.6))
    _arrow(axes, world.robot.pose, 0.5, "tab:blue")
    axes.set_aspect("equal")
    axes.set_xlim(left - 0.5, right + 0.5)
    axes.set_ylim(bottom - 0.5, top + 0.5)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    figure.savefig(file, dpi=100)


def label_positions(world: WorldFile, meters_per_inch: float) -> dict[str, tuple[float, float]]:
    """Return the center [m] of each furniture label: on the furniture if it is large enough.

    Otherwise beside it, where the label covers no other furniture, label or object if possible.
    """
    outlines = {piece.name: shapely.Polygon(corners_of(piece)) for piece in world.furniture}
    point = meters_per_inch / 72.0
    high, gap = 1.2 * _LABEL_PT * point, 0.3 * _LABEL_PT * point
    objects = [shapely.Point(thing.x, thing.y).buffer(_ARROW_M) for thing in world.objects]
    occupied = [*outlines.values(), *objects]
    positions = {}
    for name, outline in outlines.items():
        left, bottom, right, top = outline.bounds
        wide = 0.6 * _LABEL_PT * len(name) * point
        x, y = (left + right) / 2, (bottom + top) / 2
        if right - left < wide or top - bottom < 1.5 * high:
            off_x, off_y = (right - left + wide) / 2 + gap, (top - bottom + high) / 2 + gap
            around = [
                (x + right_of * off_x, y + above * off_y)
                for right_of, above in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))
            ]
            covered = [_covered_area(_box(position, wide, high), occupied) for position in around]
            x, y = around[covered.index(min(covered))]
            occupied.append(_box((x, y), wide, high))
        positions[name] = (x, y)
    return positions


def _box(middle: tuple[float, float], wide: float, high: float) -> shapely.Polygon:
    x, y = middle
    return shapely.box(x - wide / 2, y - high / 2, x + wide / 2, y + high / 2)


def _covered_area(box: shapely.Polygon, occupied: Sequence[shapely.Polygon]) -> float:
    return float(sum(box.intersection(one).area for one in occupied))


def _arrow(axes: Axes, pose: tuple[float, float, float], length: float, color: str) -> None:
    x, y, theta = pose
    axes.annotate(
        "",
        (x + length * math.cos(theta), y + length * math.sin(theta)),
        (x, y),
        arrowprops={"arrowstyle": "->", "color": color},
    )
