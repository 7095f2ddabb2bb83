"""Draws a world file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from components.simulation.scene import corners_of
from components.simulation.world_file import WorldFile

_COLOURS = {"plain": "tab:gray", "dark": "black", "glass": "tab:cyan"}


def draw_world(world: WorldFile, radius: float, file: Path) -> None:
    """Walls, furniture, objects with the way they face, people's ways, and the robot's start."""
    points = np.array([point for wall in world.walls for point in wall.points])
    (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
    width, height = right - left, top - bottom
    figure = Figure(figsize=(9.0, max(3.0, 9.0 * height / width)), layout="constrained")
    axes = figure.add_subplot()
    for wall in world.walls:
        xs, ys = zip(*wall.points, strict=True)
        axes.plot(xs, ys, color=_COLOURS[wall.surface], linewidth=2)
    for piece in world.furniture:
        colour = _COLOURS[piece.surface]
        axes.add_patch(Polygon(corners_of(piece), facecolor=colour, alpha=0.4, edgecolor=colour))
        axes.text(piece.x, piece.y, piece.name, ha="center", va="center", fontsize=7)
    for thing in world.objects:
        _arrow(axes, thing.pose, 0.35, "tab:red")
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


def _arrow(axes: Axes, pose: tuple[float, float, float], length: float, colour: str) -> None:
    x, y, theta = pose
    axes.annotate(
        "",
        (x + length * math.cos(theta), y + length * math.sin(theta)),
        (x, y),
        arrowprops={"arrowstyle": "->", "color": colour},
    )
