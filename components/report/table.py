"""The report as a table for the terminal."""

import io
import math
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

_WIDTH = 120
_COLUMNS = ("landmark", "state", "reliability", "given", "now", "true", "off by", "events")


def render_table(summary: dict[str, Any]) -> str:
    """The summary of a run as text, at most 120 columns wide."""
    console = Console(file=io.StringIO(), width=_WIDTH, highlight=False)
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column in ("state", "events") else "right")
    for thing in summary["objects"]:
        moved = thing["removed_at_s"] is not None or thing["registered_at_s"] is not None
        table.add_row(*_row(thing), style="bold" if moved else None)
    if table.rows:  # else nobody told of a map
        console.print(table)
    for line in _orders(summary):
        console.print(line)
    console.print(_closing(summary))
    file = console.file
    assert isinstance(file, io.StringIO)
    return file.getvalue()


def _row(thing: dict[str, Any]) -> tuple[str, ...]:
    off = ""
    if thing["x"] is not None and thing["true_x"] is not None:
        distance = math.hypot(thing["x"] - thing["true_x"], thing["y"] - thing["true_y"])
        off = f"{distance:.2f} m"
    events = [
        f"{word} {thing[key]:.0f} s"
        for word, key in (("removed", "removed_at_s"), ("registered", "registered_at_s"))
        if thing[key] is not None
    ]
    return (
        str(thing["id"]),
        thing["state"],
        f"{thing['reliability']:.2f}",
        _place(thing["map_x"], thing["map_y"]),
        _place(thing["x"], thing["y"]),
        _place(thing["true_x"], thing["true_y"]),
        off,
        ", ".join(events),
    )


def _place(x: float | None, y: float | None) -> str:
    return "" if x is None or y is None else f"{x:.2f}, {y:.2f}"


def _orders(summary: dict[str, Any]) -> list[str]:
    """A line for each order to move, and one for what they took together."""
    lines = []
    for order in summary["orders"]:
        why = f": {order['reason']}" if order["reason"] not in ("", "arrived") else ""
        again = f", {order['recoveries']} recoveries" if order["recoveries"] else ""
        reached = min(order["reached"], len(order["goals"]))
        lines.append(
            f"order to {len(order['goals'])} goals {order['state']}{why}: {reached} reached in "
            f"{order['seconds']:.0f} s{again}"
        )
    if lines:
        touched = [f"{touch['with']} at {touch['at_s']:.0f} s" for touch in summary["collisions"]]
        lines.append(
            f"{summary['driven_m']:.1f} m driven, collisions: {', '.join(touched) or 'none'}"
        )
    return lines


def _closing(summary: dict[str, Any]) -> str:
    lost = {port: count for port, count in summary["dropped"].items() if count}
    losses = ", ".join(f"{count} at {port}" for port, count in lost.items()) or "none"
    recorded, wall = summary["recorded_s"], summary["wall_s"]
    speed = f", {wall:.1f} s taken, {recorded / wall:.1f} times real time" if wall else ""
    if summary["first_pose_s"] is None:
        errors = "the localizer told no pose"
    elif summary["position_rmse_m"] is None:
        errors = "no truth to compare the poses with"
    else:
        errors = (
            f"position error {summary['position_rmse_m']:.3f} m rms "
            f"(at most {summary['position_error_max_m']:.2f} m), "
            f"heading error {summary['heading_rmse_rad']:.3f} rad rms"
        )
    return f"{errors}\n{recorded:.0f} s recorded{speed}; dropped: {losses}"
