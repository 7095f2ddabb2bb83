"""A room with boxes that are moved for good, the graph of its map, and the repaired grid map."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from cairn.components.slam.graph_file import write_graph
from cairn.components.slam.graph_history import GraphChange
from cairn.components.slam.keyframes import Keyframe, Submap, scan_cloud, scan_rays, scan_surfaces
from cairn.components.slam.lifelong import LifelongMap
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.pose_graph import Edge, EdgeKind
from cairn.planar.grid import UNKNOWN, Grid, OccupancyCells
from cairn.planar.posed_scans import PosedScan
from cairn.planar.poses import Pose, relative
from cairn.planar.scan_grid import ScanGrid
from cairn.planar.scans import Rays
from cairn.system.clock import SECOND
from tests.components.localizer.room import RESOLUTION, Box, beam_ends, room

REACH = 9.0
PERMANENT_S = 600.0
ROUND: tuple[Pose, ...] = tuple(
    (4.5 + 3.4 * math.cos(a), 3.5 + 2.2 * math.sin(a), a + 2.2)
    for a in np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False).tolist()
)
"""Poses of a robot on its round through the room; it sees each place from several sides."""

TABLE: Box = (4.0, 3.0, 5.5, 3.6)
MOVED: Box = (3.0, 3.8, 4.5, 4.4)

_BEAMS, _FIELD = 181, math.radians(270.0)


def scan_at(world: OccupancyCells, pose: Pose, random: np.random.Generator) -> Rays:
    """Return the rays of a scan from a pose; all are in the frame of the base."""
    angles = np.linspace(-_FIELD / 2, _FIELD / 2, _BEAMS)
    points = beam_ends(world, pose, angles, random, REACH, 0.01)
    ranges = np.full(_BEAMS, np.inf)
    bearings = np.arctan2(points[:, 1], points[:, 0])
    ranges[np.rint((bearings + _FIELD / 2) / (angles[1] - angles[0])).astype(int)] = np.hypot(
        points[:, 0], points[:, 1]
    )
    return Rays(np.zeros((_BEAMS, 2)), angles, ranges, REACH)


def write_room_graph(path: Path, boxes: Sequence[Box], poses: Sequence[Pose] = ROUND) -> None:
    """Write the graph of a room that was mapped from these poses."""
    random, mapper, world = np.random.default_rng(1), Mapper(REACH), room(tuple(boxes))
    for number, pose in enumerate(poses):
        rays = scan_at(world, pose, random)
        submap = number // 8
        mapper.keyframes.append(
            Keyframe(
                number * SECOND,
                pose,
                scan_surfaces(scan_cloud(rays, REACH)),
                scan_rays(rays),
                submap,
                0,
            )
        )
        mapper.graph.add_pose(pose)
        if number:
            step = relative(poses[number - 1], pose)
            information = np.diag([1e4, 1e4, 1e5])
            mapper.graph.edges.append(Edge(EdgeKind.STEP, number - 1, number, step, information))
        if number % 8 == 0:
            mapper.submaps.append(Submap(submap, number, number))
        mapper.submaps[-1].last = number
    write_graph(path, mapper, "a simulated room")


class RepairedRoom:
    """A room and its grid map, as a map builder repairs it; a robot drives rounds in it."""

    def __init__(self, boxes: Sequence[Box], grid: OccupancyCells) -> None:
        self.now_s = 1000.0
        self.grid = grid
        self._random = np.random.default_rng(2)
        self.furnish(boxes)

    def furnish(self, boxes: Sequence[Box]) -> None:
        """Move the boxes; the grid map is repaired by the scans of a round."""
        self.world = room(tuple(boxes))
        fresh = ScanGrid(RESOLUTION, REACH)
        for pose in ROUND:
            fresh.add(pose, scan_at(self.world, pose, self._random))
        (x, y, _), shape = self.grid.frame.origin, self.grid.values.shape
        row, column = round(y / RESOLUTION), round(x / RESOLUTION)
        seen = fresh.window(row, column, (shape[0], shape[1]))
        cells = np.where(seen == UNKNOWN, self.grid.values, seen)
        self.grid = Grid(cells, self.grid.frame)

    def drive(
        self, graph: LifelongMap, seconds: float, poses: Iterable[Pose] = ROUND
    ) -> list[GraphChange]:
        """Let time pass, then drive a round with a scan each second; return the changes."""
        graph.set_map(self.grid)
        graph.work(round(self.now_s * SECOND))
        self.now_s += seconds
        made = []
        covariance = np.diag([0.02**2, 0.02**2, 0.005**2])
        for pose in poses:
            self.now_s += 1.0
            stamp = round(self.now_s * SECOND)
            scan = PosedScan(stamp, pose, scan_at(self.world, pose, self._random))
            graph.add_scan(scan, covariance)
            change = graph.work(stamp)
            if change is not None:
                made.append(change)
        return made


def random_boxes(boxes: Sequence[Box], random: np.random.Generator) -> list[Box]:
    """Return the boxes after one was moved, added or removed; at most four, off the round."""
    width, height = random.uniform(0.4, 1.5), random.uniform(0.4, 0.9)
    x, y = random.uniform(2.6, 6.4 - width), random.uniform(2.4, 4.6 - height)
    new, index = (x, y, x + width, y + height), int(random.integers(4))
    if index >= len(boxes):
        return [*boxes, new]
    others = [box for k, box in enumerate(boxes) if k != index]
    return others if random.random() < 0.3 else [*others, new]
