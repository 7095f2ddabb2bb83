"""The report as a table for the terminal."""

import io
import math
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

_WIDTH = 120
_REAL_TIME = 1.1  # times the speed of a real robot, whose clock may be adjusted
_COLUMNS = ("landmark", "state", "reliability", "given", "now", "true", "off by", "events")


def render_table(summary: dict[str, Any]) -> str:
    """Return the summary of a run as text, at most 120 columns wide."""
    text = io.StringIO()
    console = Console(file=text, width=_WIDTH, highlight=False)
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column in ("state", "events") else "right")
    for landmark in summary["objects"]:
        moved = landmark["removed_at_s"] is not None or landmark["registered_at_s"] is not None
        table.add_row(*_row(landmark), style="bold" if moved else None)
    if table.rows:  # without a visual map there are none
        console.print(table)
    for line in _mission_lines(summary):
        console.print(line)
    console.print(_closing(summary))
    return text.getvalue()


def _row(landmark: dict[str, Any]) -> tuple[str, ...]:
    off = ""
    if landmark["x"] is not None and landmark["true_x"] is not None:
        distance = math.hypot(
            landmark["x"] - landmark["true_x"], landmark["y"] - landmark["true_y"]
        )
        off = f"{distance:.2f} m"
    events = [
        f"{word} {landmark[key]:.0f} s"
        for word, key in (("removed", "removed_at_s"), ("registered", "registered_at_s"))
        if landmark[key] is not None
    ]
    return (
        str(landmark["id"]),
        landmark["state"],
        f"{landmark['reliability']:.2f}",
        _place(landmark["map_x"], landmark["map_y"]),
        _place(landmark["x"], landmark["y"]),
        _place(landmark["true_x"], landmark["true_y"]),
        off,
        ", ".join(events),
    )


def _place(x: float | None, y: float | None) -> str:
    return "" if x is None or y is None else f"{x:.2f}, {y:.2f}"


def _mission_lines(summary: dict[str, Any]) -> list[str]:
    """Return a line for each mission, and one for what they took together."""
    lines = []
    for mission in summary["missions"]:
        why = f": {mission['reason']}" if mission["reason"] not in ("", "arrived") else ""
        again = f", {mission['recoveries']} recoveries" if mission["recoveries"] else ""
        reached = min(mission["reached"], len(mission["goals"]))
        lines.append(
            f"mission to {len(mission['goals'])} goals {mission['state']}{why}: {reached} reached "
            f"in {mission['seconds']:.0f} s{again}"
        )
    if lines:
        collisions = [f"{one['with']} at {one['at_s']:.0f} s" for one in summary["collisions"]]
        lines.append(
            f"{summary['driven_m']:.1f} m driven, collisions: {', '.join(collisions) or 'none'}"
        )
    return lines


def _closing(summary: dict[str, Any]) -> str:
    lost = {port: count for port, count in summary["dropped"].items() if count}
    losses = ", ".join(f"{count} at {port}" for port, count in lost.items()) or "none"
    recorded, wall = summary["recorded_s"], summary["wall_s"]
    speed = f", {wall:.1f} s taken, {recorded / wall:.1f} times real time" if wall else ""
    if summary["first_pose_s"] is None:
        errors = "the localizer published no pose"
    elif summary["position_rmse_m"] is None:
        errors = "no truth to compare the poses with"
    else:
        errors = (
            f"position error {summary['position_rmse_m']:.3f} m rms "
            f"(at most {summary['position_error_max_m']:.2f} m), "
            f"heading error {summary['heading_rmse_rad']:.3f} rad rms"
        )
    remedy = (
        ": this computer is too slow for that speed; replay more slowly, or with --lockstep"
        if lost and wall and recorded > _REAL_TIME * wall
        else ""
    )
    return f"{errors}\n{recorded:.0f} s recorded{speed}; dropped: {losses}{remedy}"
