"""The two pictures of a report: the map with the paths, and the reliabilities over time."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Affine2D

from cairn.components.run_outputs.run_record import ObjectRecord, RunRecord
from cairn.planar.grid import OCCUPIED_FROM, grid_of
from cairn.planar.poses import compose
from cairn.schemas.nav_msgs import OccupancyGrid

_TRUE = "#9a9a9a"
_ESTIMATE = "#1f6fb4"
_OLD = "#c8321e"
_NEW = "#1d8a3a"
_OLD_CELLS = "#f0b8ae"
_CHANGED = ("#c8321e", "#7a3fb0", "#d98200", "#0f8f8a", "#b0307e", "#5b6d00")


def draw_map(
    record: RunRecord, grids: tuple[OccupancyGrid, OccupancyGrid] | None, file: Path
) -> None:
    """Draw the true and the estimated path and each object's old, new and true position.

    `grids` are the first and the newest grid map: what has changed is colored.
    """
    shape = 1.0 if grids is None else grids[1].info.height / max(1, grids[1].info.width)
    figure = Figure(figsize=(9, max(5.0, 9 * shape + 1.5 * (shape < 1))), layout="constrained")
    axes = figure.add_subplot()
    if grids is not None:
        _draw_grids(axes, *grids)
    _draw_goals(axes, record)
    true, estimate = record.truth.to_draw(), record.estimate.to_draw()
    axes.plot(true[:, 0], true[:, 1], color=_TRUE, linewidth=2.0, alpha=0.7)
    axes.plot(estimate[:, 0], estimate[:, 1], color=_ESTIMATE, linewidth=0.8)
    for landmark in record.objects.values():
        _draw_object(axes, landmark)
    _place_labels(axes, record.objects.values())
    axes.set_aspect("equal", adjustable="datalim" if grids is None else "box")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.25)
    error = record.errors().position_rmse
    title = "The repaired map" if grids is not None else "The repaired visual map"
    axes.set_title(title + (f": position error {error:.3f} m rms" if error is not None else ""))
    figure.legend(
        handles=_legend(record, grids is not None),
        loc="outside lower center",
        ncols=3,
        frameon=False,
    )
    _save(figure, file)


def draw_reliability(record: RunRecord, file: Path) -> None:
    """Draw each object's reliability over time; those removed or registered in color."""
    changed = [landmark for landmark in record.objects.values() if _has_moved(landmark)]
    still = [landmark for landmark in record.objects.values() if not _has_moved(landmark)]
    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.add_subplot()
    for landmark in still:
        axes.step(*_curve(record, landmark), where="post", color="#b4bcc4", linewidth=0.9)
    for index, landmark in enumerate(changed):
        color = _CHANGED[index % len(_CHANGED)]
        words = [f"landmark {landmark.object_id}"]
        for stamp, marker, word in (
            (landmark.moves.last.removed_at, "v", "removed"),
            (landmark.moves.last.registered_at, "^", "registered"),
        ):
            seconds = record.seconds(stamp)
            if seconds is not None:
                axes.plot(seconds, 0.1 if marker == "v" else 0.5, marker, color=color, markersize=9)
                words.append(f"{word} at {seconds:.0f} s")
        axes.step(
            *_curve(record, landmark), where="post", color=color, linewidth=1.8,
            label=", ".join(words),
        )  # fmt: skip
    for threshold, word in ((0.1, "removed at 0.1 or less"), (0.5, "registered above 0.5")):
        axes.axhline(threshold, color="black", linewidth=0.6, linestyle=":")
        axes.text(0.45, threshold + 0.01, word, transform=axes.get_yaxis_transform(), fontsize=8,
                  ha="left", color="#505050")  # fmt: skip
    if still:
        axes.plot([], [], color="#b4bcc4", label=f"the {len(still)} that stood still")
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("time since the recording began [s]")
    axes.set_ylabel("pose reliability")
    axes.set_title("Pose reliability of each landmark (equations 1 and 2)")
    axes.grid(alpha=0.25)
    if record.objects:
        axes.legend(loc="center right", fontsize=9, framealpha=0.9)
    _save(figure, file)


def _draw_grids(axes: Axes, first: OccupancyGrid, last: OccupancyGrid) -> None:
    before, now = grid_of(first).values, grid_of(last).values
    picture = np.full((*now.shape, 3), 0.85)
    picture[(now >= 0) & (now < OCCUPIED_FROM)] = 1.0
    picture[now >= OCCUPIED_FROM] = 0.25
    if before.shape == now.shape:
        was, is_now = before >= OCCUPIED_FROM, now >= OCCUPIED_FROM
        picture[was & ~is_now] = to_rgb(_OLD_CELLS)
        picture[is_now & ~was] = to_rgb(_NEW)
    frame = grid_of(last).frame
    x, y, theta = frame.origin
    height, width = (count * frame.resolution for count in now.shape)
    image = axes.imshow(picture, origin="lower", extent=(0, width, 0, height), zorder=0)
    image.set_transform(Affine2D().rotate(theta).translate(x, y) + axes.transData)
    corners = [compose(frame.origin, (a, b, 0.0))[:2] for a in (0, width) for b in (0, height)]
    (left, bottom), (right, top) = np.min(corners, axis=0), np.max(corners, axis=0)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)


def _draw_goals(axes: Axes, record: RunRecord) -> None:
    number = 0
    labels: dict[tuple[float, float], list[str]] = {}
    for _, mission in sorted(record.missions.items()):
        for index, (x, y, theta) in enumerate(mission.goals):
            number += 1
            reached = index < mission.reached or mission.state == "succeeded"
            color = _NEW if reached else _OLD
            axes.plot(x, y, "D", color=color, markersize=6, alpha=0.8)
            axes.annotate(
                "", (x + 0.35 * np.cos(theta), y + 0.35 * np.sin(theta)), (x, y),
                arrowprops={"arrowstyle": "->", "color": color},
            )  # fmt: skip
            labels.setdefault((round(x, 1), round(y, 1)), []).append(str(number))
    for position, numbers in labels.items():
        axes.annotate(
            f"goal {', '.join(numbers)}", position, (-8, -14), textcoords="offset points",
            fontsize=8, color=_NEW,
        )  # fmt: skip
    for collision in record.collisions:
        axes.plot(collision.x, collision.y, "*", color="red", markersize=14)


def _draw_object(axes: Axes, landmark: ObjectRecord) -> None:
    if landmark.true_position is not None:
        axes.plot(*landmark.true_position, "+", color="black", markersize=11, markeredgewidth=1.3)
    moved = _has_moved(landmark)
    if landmark.map_position is not None and moved:
        axes.plot(*landmark.map_position, "x", color=_OLD, markersize=10, markeredgewidth=2.2)
    if landmark.position is not None and landmark.state == "live":
        axes.plot(
            *landmark.position, "o", color=_NEW if moved else _ESTIMATE,
            markersize=9 if moved else 6, fillstyle="none", markeredgewidth=1.8,
        )  # fmt: skip
        if landmark.map_position is not None and moved:
            axes.annotate(
                "", landmark.position, landmark.map_position,
                arrowprops={"arrowstyle": "->", "color": _OLD, "linestyle": "--", "alpha": 0.7},
            )  # fmt: skip


def _place_labels(axes: Axes, landmarks: Iterable[ObjectRecord]) -> None:
    """Label the objects; those that stand close together share one label."""
    positions = [
        (landmark.position or landmark.map_position or landmark.true_position, landmark)
        for landmark in landmarks
    ]
    groups: list[tuple[tuple[float, float], list[str]]] = []
    for position, landmark in positions:
        if position is None:
            continue
        near = next(
            (g for g in groups if np.hypot(g[0][0] - position[0], g[0][1] - position[1]) < 0.5),
            None,
        )
        if near is None:
            groups.append((position, [str(landmark.object_id)]))
        else:
            near[1].append(str(landmark.object_id))
    for position, labels in groups:
        axes.annotate(
            ", ".join(labels), position, (9, 7), textcoords="offset points", fontsize=9,
            fontweight="bold", color="#303030",
        )  # fmt: skip


def _legend(record: RunRecord, with_grid: bool) -> list[Line2D]:
    def mark(marker: str, color: str, label: str) -> Line2D:
        return Line2D(
            [], [], color=color, marker=marker, linestyle="", fillstyle="none", markersize=8,
            markeredgewidth=1.8, label=label,
        )  # fmt: skip

    more = []
    if record.missions:
        more.append(mark("D", _NEW, "goal reached"))
    if with_grid:
        more.append(Line2D([], [], color=_OLD_CELLS, linewidth=6, label="cells freed"))
        more.append(Line2D([], [], color=_NEW, linewidth=6, label="cells newly occupied"))
    if record.collisions:
        more.append(mark("*", "red", "collision"))
    return [
        Line2D([], [], color=_TRUE, linewidth=2, label="true path"),
        Line2D([], [], color=_ESTIMATE, label="estimated path"),
        mark("+", "black", "true position"),
        mark("o", _ESTIMATE, "landmark in the map"),
        mark("x", _OLD, "removed: where the map had it"),
        mark("o", _NEW, "registered: where it is now"),
        *more,
    ]


def _curve(record: RunRecord, landmark: ObjectRecord) -> tuple[list[float], list[float]]:
    stamps = [record.seconds(stamp) or 0.0 for stamp, _ in landmark.history]
    values = [value for _, value in landmark.history]
    end = record.seconds(record.end)
    if stamps and end is not None:
        stamps.append(end)
        values.append(values[-1])
    return stamps, values


def _has_moved(landmark: ObjectRecord) -> bool:
    return bool(landmark.moves.standing)


def _save(figure: Figure, file: Path) -> None:
    # Without the software's name and the date, the same run gives the same bytes.
    figure.savefig(file, dpi=110, metadata={"Software": None})
