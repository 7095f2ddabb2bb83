"""A hundred hours of permanent changes of a room: sizes of its graph, and what it draws."""

import sqlite3
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from cairn.components.slam.graph_history import GraphHistory, draw_state, read_log
from cairn.components.slam.lifelong import LifelongMap
from cairn.components.slam.map_differences import MapDifferences
from cairn_lab.benchmarks.result import Metric
from tests.components.localizer.room import RESOLUTION
from tests.components.slam.changing_room import (
    PERMANENT_S,
    REACH,
    TABLE,
    RepairedRoom,
    random_boxes,
    write_room_graph,
)

HOURS, EVERY_S = 100.0, 1200.0
AREA_M2 = 9.0 * 7.0
PER_M2 = 4.0


def measure() -> list[Metric]:
    """Move boxes in a room every 20 minutes; a robot drives two rounds after each change."""
    random, began = np.random.default_rng(5), time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "room.graph"
        write_room_graph(path, [TABLE])
        with GraphHistory(path) as history:
            graph = LifelongMap(history, PERMANENT_S, PER_M2)
            there = RepairedRoom([TABLE], draw_state(history.state(), RESOLUTION).grid())
            start_s, boxes, sizes, keyframes = there.now_s, [TABLE], [], []
            while there.now_s - start_s < HOURS * 3600.0:
                boxes = random_boxes(boxes, random)
                there.furnish(boxes)
                for _ in range(2):
                    there.drive(graph, EVERY_S / 2)
                sizes.append(_size_of(path))
                keyframes.append(graph.keyframes)
            for _ in range(4):
                there.drive(graph, EVERY_S)
            drawing = draw_state(history.state(), RESOLUTION)
            left = MapDifferences(there.grid, drawing).count
            changes = read_log(path).version
        half = len(sizes) // 2
    return [
        Metric("keyframes in the map, most", max(keyframes), "", at_most=PER_M2 * AREA_M2 * 1.2),
        Metric("size of the graph, most", max(sizes) / 1e6, "MB", at_most=0.1 * AREA_M2,
               note=f"{changes} changes, scans of {REACH:g} m"),
        Metric("size of the graph, second half to first half",
               max(sizes[half:]) / max(sizes[:half]), "", at_most=1.1),
        Metric("obstacle cells that differ from the grid map in the end", left, "", at_most=10),
        Metric("time", time.monotonic() - began, "s", note=f"for {HOURS:g} h"),
    ]  # fmt: skip


def _size_of(path: Path) -> int:
    with closing(sqlite3.connect(path)) as connection:
        ((pages,),) = connection.execute("PRAGMA page_count").fetchall()
        ((size,),) = connection.execute("PRAGMA page_size").fetchall()
    return int(pages * size)
