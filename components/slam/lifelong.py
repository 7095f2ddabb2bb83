"""Lifelong maps: permanent changes of a building go into its graph, and what is old is retired.

In normal operation the map builder repairs the grid map. Where that differs from the drawing of the
graph for long, scans of the changed place become a new submap of the graph, and in this place only
they and later ones count. Of keyframes that became many in one area, those go that the drawing
needs least. So the size of the graph depends on the area, not on the time.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.slam.graph_history import (
    ChangedBlock,
    GraphChange,
    GraphHistory,
    Renewal,
    change_between,
)
from cairn.components.slam.keyframes import Keyframe, scan_cloud, scan_rays, scan_surfaces
from cairn.components.slam.map_differences import BLOCK_M, Block, MapDifferences, differing
from cairn.components.slam.pose_graph import Edge, EdgeKind, turned
from cairn.planar.grid import UNKNOWN, OccupancyCells
from cairn.planar.posed_scans import PosedScan
from cairn.planar.poses import Pose, apart, distance, relative, wrap_all
from cairn.planar.renewals import Renewals, patches_of
from cairn.planar.scan_grid import ScanGrid
from cairn.planar.scans import Rays

Array = NDArray[np.float64]

# Where no other reason is given, these constants were chosen by hand.

# Keyframes that are drawn in one call, at about 1 ms each.
_DRAWN = 60
# A block with fewer differing cells, with those of the blocks around it, differs by noise.
_LEAST_CELLS = 3
# If more of a block's differing cells than this share are others, its change is a new one.
_SAME_SHARE = 0.5
# Scans of a changed place: two of poses nearer than this [m], [rad] are one, the newer; so many
# wait in all, which is 1 MB, and so many become keyframes.
_APART_M, _APART_RAD, _WAITING = 0.3, 0.4, 24
_SUBMAP_SIZES = (2, 4, 8)
# Differences are noted in the file at most this often [s]: a kill makes a change so much later.
_NOTES_S = 10.0
# A block is seen up to this distance [m], if a ray ends no farther before its middle [m].
_SEEN_M, _BEFORE_M = 10.0, 0.4
# The robot has this long to see all of a changed place [s]; then what it has seen is changed.
_GATHERING_S = 20.0
# The scans renew a place if this share of its differing cells remains, or less.
_REMAINS = 0.3
# If they do not, the place is tried again after this [s], doubled each time up to the other [s].
_FIRST_RETRY_S, _LAST_RETRY_S = 1.0, 600.0
# A keyframe is retired if this share of its points lies where only newer ones count.
_OUTDATED = 0.8
# Keyframes near a change of which the least needed ones are retired, at about 3 ms each.
_COMPARED = 60
# The localizer's covariance is at least this [m], [rad]: it shares errors between scans.
_LEAST_SD_M, _LEAST_SD_RAD = 0.02, 0.005
# History that is kept: former tiles and rows of changes, for each tile of the map, and more.
_TILES, _MORE_TILES, _CHANGES, _MORE_CHANGES = 8, 64, 20, 200
# Share of the drawing's obstacles that differ, from which on the maps are not of one building.
_FOREIGN = 0.5


@dataclass
class _Pending:
    """A block that differs, when it was first seen so after long, and is tried again [ns]."""

    change: ChangedBlock
    seen_ns: int | None = None
    retry_ns: int = 0
    wait_s: float = _FIRST_RETRY_S


@dataclass(frozen=True)
class _ChangedScan:
    """A scan that sees changed blocks, and the covariance (3, 3) of its pose."""

    scan: PosedScan
    covariance: Array
    blocks: frozenset[Block]


class LifelongMap:
    """A graph that follows the permanent changes of the grid map.

    Changes are committed to the graph's file before they count.
    """

    def __init__(self, history: GraphHistory, permanent_s: float, keyframes_per_m2: float) -> None:
        """Read a graph; raises `CairnError` if its file is damaged.

        Args:
            history: the graph's file.
            permanent_s: how long the grid map must differ from the graph [s].
            keyframes_per_m2: most keyframes in the map, and again as retired ones, per known area.

        """
        self._history = history
        self._permanent_ns = round(permanent_s * SECOND)
        self._per_m2 = keyframes_per_m2
        state = history.state()
        self.version = state.version
        self._farthest = state.farthest
        self._renewals = state.renewals
        self._frames = dict(zip(state.numbers, state.keyframes, strict=True))
        poses = [(x, y, theta) for x, y, theta in state.poses.tolist()]
        self._poses: dict[int, Pose] = dict(zip(state.numbers, poses, strict=True))
        self._edges = history.edges(state.numbers)
        self.drawing: ScanGrid | None = None
        """The drawing of the keyframes; None before `set_map`."""
        self._undrawn: list[int] = []
        self._grid: OccupancyCells | None = None
        self._differences: MapDifferences | None = None
        self._noted = history.differences()
        self._noted_ns: int | None = None
        self._pending = {block: _Pending(one) for block, one in self._noted.items()}
        self._waiting: list[_ChangedScan] = []
        self.is_of_other_building = False
        """Whether the grid map has mostly other obstacles than the graph, which then stays."""
        self._changed: Renewal | None = None  # after which too many keyframes may be left

    @property
    def keyframes(self) -> int:
        """Number of keyframes in the map."""
        return len(self._frames)

    @property
    def pending(self) -> int:
        """Number of blocks that differ and may be changed later."""
        return len(self._pending)

    def set_map(self, grid: OccupancyCells) -> None:
        """Set the whole grid map; raises `CairnError` if it cannot be that of the graph."""
        known = self._differences
        if (
            known is not None
            and self._grid is not None
            and self._grid.frame == grid.frame
            and known.cells.shape == grid.values.shape
        ):
            if not np.array_equal(known.cells, grid.values):
                known.update(0, 0, np.array(grid.values))
                self._check_building(known)
            return
        if self._grid is not None:
            self._pending.clear()
        self._grid, self._differences = grid, None
        self.is_of_other_building = False
        resolution = grid.frame.resolution
        if self.drawing is None or self.drawing.frame.resolution != resolution:
            self.drawing = ScanGrid(resolution, self._farthest)
            self.drawing.renew(self._renewals)
            self._undrawn = sorted(self._frames)
        self._compare_when_drawn()

    def update_map(self, row: int, column: int, values: NDArray[np.int8]) -> None:
        """Replace a window of the grid map; without effect before `set_map`."""
        grid = self._grid
        if grid is None:
            return
        rows, columns = grid.values.shape
        if row + values.shape[0] > rows or column + values.shape[1] > columns:
            return  # of a map whose message has not arrived yet
        if self._differences is not None:
            self._differences.update(row, column, values)
            return
        cells = np.array(grid.values)
        cells[row : row + values.shape[0], column : column + values.shape[1]] = values
        self._grid = OccupancyCells(cells, grid.frame)

    def add_scan(self, scan: PosedScan, covariance: Array) -> None:
        """Keep a scan if it sees a block that has differed for long.

        `covariance` (3, 3) of its pose is over x, y [m] and heading [rad] in the map.
        """
        seen = _seen_blocks(scan, self._due(scan.stamp_ns))
        if not seen:
            return
        for block in seen:
            pending = self._pending[block]
            pending.seen_ns = scan.stamp_ns if pending.seen_ns is None else pending.seen_ns
        waiting = [
            other
            for other in self._waiting
            if apart(other.scan.pose, scan.pose, _APART_M, _APART_RAD)
        ]
        self._waiting = [*waiting, _ChangedScan(scan, covariance, seen)][-_WAITING:]

    def work(self, now_ns: int) -> GraphChange | None:
        """Draw and compare, retire what is not needed, or make a change that is due; return it.

        Raises `CairnError` if the file cannot be written: the map stays, and a later call tries
        again.
        """
        self._draw()
        if self._changed is not None:
            self._thin(self._changed)
            self._changed = None
        differences = self._differences
        if differences is None:
            return None
        self._follow(differences.blocks(), now_ns)
        if self.is_of_other_building:
            return None
        self._note(now_ns)
        if not self._waiting:
            return None
        for cluster in self._clusters(now_ns):
            renewal = self._renewal(differences, cluster, now_ns)
            if renewal is None:
                self._postpone(cluster, now_ns)
                continue
            self._make(renewal)
            self._changed = renewal
            differences.compare()
            self._follow(differences.blocks(), now_ns)
            return renewal.change
        return None

    def _draw(self) -> None:
        if self.drawing is None or not self._undrawn:
            return
        now, self._undrawn = self._undrawn[:_DRAWN], self._undrawn[_DRAWN:]
        for number in now:
            frame = self._frames[number]
            if frame.rays is not None:
                self.drawing.add(self._poses[number], frame.rays.rays(), frame.version)
        self._compare_when_drawn()

    def _compare_when_drawn(self) -> None:
        if self._undrawn or self._grid is None or self.drawing is None:
            return
        self._differences = MapDifferences(self._grid, self.drawing)
        self._check_building(self._differences)

    def _check_building(self, differences: MapDifferences) -> None:
        assert self.drawing is not None
        obstacles = int(np.count_nonzero(self.drawing.whole().values > 0))
        self.is_of_other_building = differences.count > _FOREIGN * max(1, obstacles)

    def _follow(self, blocks: Mapping[Block, frozenset[tuple[int, int]]], now_ns: int) -> None:
        """Note which blocks differ, and since when."""
        pending: dict[Block, _Pending] = {}
        for block, cells in blocks.items():
            column, row = block
            around = (
                len(blocks.get((column + dx, row + dy), ()))
                for dx in (-1, 0, 1)
                for dy in (-1, 0, 1)
            )
            if sum(around) < _LEAST_CELLS:
                continue
            pending[block] = _Pending(ChangedBlock(now_ns, cells))
            if (known := self._pending.get(block)) is not None:
                before = known.change.cells
                most_others = max(_LEAST_CELLS, _SAME_SHARE * len(before))
                # Time that was set back starts the wait again.
                if len(before ^ cells) <= most_others and known.change.since_ns <= now_ns:
                    pending[block] = known
        self._pending = pending
        due = self._due(now_ns)
        self._waiting = [
            replace(one, blocks=one.blocks & due) for one in self._waiting if one.blocks & due
        ]

    def _due(self, now_ns: int) -> set[Block]:
        """Return the blocks that have differed for long enough."""
        return {
            block
            for block, one in self._pending.items()
            if now_ns - one.change.since_ns >= self._permanent_ns
        }

    def _note(self, now_ns: int) -> None:
        """Note in the file which blocks differ, and since when: a restart must not delay them."""
        since = self._noted_ns
        if since is not None and 0 <= now_ns - since < round(_NOTES_S * SECOND):
            return
        noted = {block: one.change for block, one in self._pending.items()}
        news = {block: one for block, one in noted.items() if self._noted.get(block) != one}
        gone = self._noted.keys() - noted.keys()
        if news or gone:
            self._history.note_differences(news, gone)
            self._noted, self._noted_ns = noted, now_ns

    def _clusters(self, now_ns: int) -> list[frozenset[Block]]:
        """Return the changed places to try now: connected blocks that have differed for long."""
        left = self._due(now_ns)
        seen = frozenset[Block]().union(*(one.blocks for one in self._waiting))
        clusters = []
        while left:
            found, border = set[Block](), [min(left)]
            while border:
                column, row = border.pop()
                if (column, row) in found:
                    continue
                found.add((column, row))
                beside = {(column + dx, row + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
                border += sorted((beside - found) & left)
            left -= found
            known = found & seen
            if known and self._is_due(found, known, now_ns):
                clusters.append(frozenset(known))
        return clusters

    def _is_due(self, place: Collection[Block], seen: Collection[Block], now_ns: int) -> bool:
        """Return whether a place is tried now: all of it was seen, or there was time to see it."""
        blocks = [self._pending[block] for block in seen]
        longest = round(_LAST_RETRY_S * SECOND)
        # Time that was set back must not delay a place further.
        if not any(one.retry_ns <= now_ns or one.retry_ns > now_ns + longest for one in blocks):
            return False
        first = min(now_ns if one.seen_ns is None else one.seen_ns for one in blocks)
        return len(seen) == len(place) or now_ns - first >= round(_GATHERING_S * SECOND)

    def _postpone(self, cluster: Iterable[Block], now_ns: int) -> None:
        for block in cluster:
            one = self._pending[block]
            one.retry_ns = now_ns + round(one.wait_s * SECOND)
            one.wait_s = min(2.0 * one.wait_s, _LAST_RETRY_S)

    def _renewal(
        self, differences: MapDifferences, cluster: frozenset[Block], now_ns: int
    ) -> Renewal | None:
        """Return the change of a place, if the scans that see it explain the grid map there."""
        scans = [one for one in reversed(self._waiting) if one.blocks & cluster]
        margin = math.ceil(BLOCK_M / differences.resolution)
        rows, columns, inside = differences.window_of(cluster, margin)
        corner = differences.row + rows.start, differences.column + columns.start
        shape = inside.shape[0], inside.shape[1]
        cells, old = differences.cells[rows, columns], differences.drawn(rows, columns)
        most = int(_REMAINS * np.count_nonzero(differing(cells, old) & inside))
        best: tuple[list[tuple[_ChangedScan, Rays]], Renewals, NDArray[np.int8]] | None = None
        for size in _SUBMAP_SIZES:
            chosen = [
                (one, differences.explained(one.scan.pose, one.scan.rays)) for one in scans[:size]
            ]
            fresh = ScanGrid(differences.resolution, self._farthest)
            for one, rays in chosen:
                fresh.add(one.scan.pose, rays)
            shown = fresh.window(*corner, shape)
            row, column = np.nonzero(inside & (shown != UNKNOWN))
            centers = np.column_stack((column + corner[1], row + corner[0])) + 0.5
            patches = np.unique(patches_of(centers * differences.resolution), axis=0)
            renewals = self._renewals.renewed(patches, self.version + 1)
            renewed = renewals.cells(*corner, shape, differences.resolution) == self.version + 1
            new = np.where(renewed, shown, old)
            left = int(np.count_nonzero(differing(cells, new) & inside))
            if left <= most:
                best, most = (chosen, renewals, new), left - 1
            if left == 0 or size >= len(scans):
                break
        if best is None:
            return None
        chosen, renewals, new = best
        since_ns = min(self._pending[block].change.since_ns for block in cluster)
        stood_s = (now_ns - since_ns) / SECOND
        shown_by = "1 scan shows" if len(chosen) == 1 else f"{len(chosen)} scans show"
        reason = f"the grid map had it for {stood_s:.0f} s; {shown_by} it"
        change = change_between(old, new, corner, differences.resolution, now_ns, reason)
        return self._with_constraints(change, chosen, renewals)

    def _with_constraints(
        self, change: GraphChange, chosen: list[tuple[_ChangedScan, Rays]], renewals: Renewals
    ) -> Renewal:
        """Return a change with its keyframes, tied to the nearest ones that stay."""
        outdated = {number for number in self._frames if self._is_outdated(number, renewals)}
        first = self._history.next_number()
        frames, poses, edges = [], [], []
        for number, (one, rays) in enumerate(reversed(chosen), start=first):
            pose = one.scan.pose
            frames.append(
                Keyframe(
                    one.scan.stamp_ns, pose, scan_surfaces(scan_cloud(rays, self._farthest)),
                    scan_rays(rays), 0, self.version + 1,
                )
            )  # fmt: skip
            poses.append(pose)
            known = self._frames.keys() - outdated or self._frames.keys()
            if known:
                anchor = min(known, key=lambda k: distance(self._poses[k], pose))
                measured = relative(self._poses[anchor], pose)
                information = _information(one.covariance, pose[2])
                edges.append(Edge(EdgeKind.MATCH, anchor, number, measured, information))
        every = self._poses | dict(enumerate(poses, start=first))
        bridges = bridging([*self._edges, *edges], outdated, every)
        return Renewal(change, poses, frames, renewals, outdated, [*edges, *bridges])

    def _is_outdated(self, number: int, renewals: Renewals) -> bool:
        frame = self._frames[number]
        if not frame.surfaces.count:
            return False
        points = frame.cloud.placed(self._poses[number]).points
        return bool(np.mean(renewals.since(points) > frame.version) >= _OUTDATED)

    def _make(self, renewal: Renewal) -> None:
        first = self._history.next_number()
        self.version = self._history.renew(self.version, renewal)
        assert self.drawing is not None
        self._renewals = renewal.renewals
        self.drawing.renew(renewal.renewals)
        for number, (frame, pose) in enumerate(
            zip(renewal.keyframes, renewal.poses, strict=True), start=first
        ):
            self._frames[number], self._poses[number] = frame, pose
            if frame.rays is not None:
                self.drawing.add(pose, frame.rays.rays(), frame.version)
        self._retire(renewal.retired, renewal.edges)

    def _thin(self, renewal: Renewal) -> None:
        """Retire the least needed keyframes near a change while there are too many."""
        assert self.drawing is not None
        known_m2 = (
            np.count_nonzero(self.drawing.whole().values != UNKNOWN)
            * self.drawing.frame.resolution**2
        )
        most = math.ceil(self._per_m2 * known_m2)
        excess = min(len(self._frames) - most, 2 * len(renewal.keyframes))
        if excess > 0:
            retired = self._least_needed(renewal, excess)
            bridges = bridging(self._edges, retired, self._poses)
            self._history.retire(retired, bridges)
            self._retire(retired, bridges)
        tiles = len(self._renewals.tiles)
        self._history.prune(
            keyframes=most,
            tiles=_TILES * tiles + _MORE_TILES,
            changes=_CHANGES * tiles + _MORE_CHANGES,
        )

    def _least_needed(self, renewal: Renewal, count: int) -> set[int]:
        """Return keyframes near a change without which the drawing changes least."""
        drawing = self.drawing
        assert drawing is not None
        place = (renewal.change.x, renewal.change.y, 0.0)
        older = [k for k, frame in self._frames.items() if frame.version < self.version]
        near = sorted(older, key=lambda k: (distance(self._poses[k], place), k))[:_COMPARED]
        rays = {k: frame.rays.rays() for k in near if (frame := self._frames[k]).rays is not None}

        def change_without(number: int) -> int:
            if number not in rays:
                return 0
            version = self._frames[number].version
            return drawing.change_without(self._poses[number], rays[number], version)

        heap = [(change_without(k), k) for k in near]
        heapify(heap)
        chosen: list[int] = []
        while heap and len(chosen) < count:
            before, number = heappop(heap)
            # Those that were chosen meanwhile may have made it more important.
            now = change_without(number)
            if now > before and heap and now > heap[0][0]:
                heappush(heap, (now, number))
                continue
            chosen.append(number)
            if number in rays:
                drawing.remove(self._poses[number], rays[number], self._frames[number].version)
        for number in chosen:  # until they are retired in the file
            if number in rays:
                drawing.add(self._poses[number], rays[number], self._frames[number].version)
        return set(chosen)

    def _retire(self, retired: Collection[int], edges: Sequence[Edge]) -> None:
        """Remove keyframes and their constraints, and add others in the place of these."""
        assert self.drawing is not None
        for number in retired:
            frame, pose = self._frames.pop(number), self._poses.pop(number)
            if frame.rays is not None:
                self.drawing.remove(pose, frame.rays.rays(), frame.version)
        every, known = [*self._edges, *edges], self._frames.keys()
        self._edges = [e for e in every if e.first in known and e.second in known]


def bridging(
    edges: Iterable[Edge], retired: Collection[int], poses: Mapping[int, Pose]
) -> list[Edge]:
    """Return constraints that keep connected what was connected by retired keyframes.

    For each of these, its neighbors are tied to that one of them that was tied best. The
    uncertainty of a constraint is that of both that it replaces, in all directions.
    """
    around: dict[int, dict[int, Edge]] = {}
    for edge in edges:
        for end, other in ((edge.first, edge.second), (edge.second, edge.first)):
            best = around.setdefault(end, {}).get(other)
            if best is None or _certainty(edge) > _certainty(best):
                around[end][other] = edge
    added: dict[tuple[int, int], Edge] = {}
    for number in sorted(retired):
        neighbors = around.pop(number, {})
        for other in neighbors:
            del around[other][number]
        if len(neighbors) < 2:
            continue
        hub = max(neighbors, key=lambda k: (_certainty(neighbors[k]), k))
        for other, edge in neighbors.items():
            if other == hub or other in around[hub]:
                continue
            measured = relative(poses[hub], poses[other])
            information = _joined(neighbors[hub], edge, poses[number], poses[other])
            new = Edge(EdgeKind.MATCH, hub, other, measured, information)
            around[hub][other] = around[other][hub] = added[hub, other] = new
    gone = set(retired)
    return [edge for ends, edge in added.items() if not gone & set(ends)]


def _certainty(edge: Edge) -> float:
    return float(np.trace(edge.information[:2, :2]))


def _joined(first: Edge, second: Edge, middle: Pose, end: Pose) -> Array:
    """Return the information of the way along two constraints, the same in all directions."""
    covariances = [np.linalg.inv(e.information + 1e-6 * np.eye(3)) for e in (first, second)]
    positions = [float(np.linalg.eigvalsh(c[:2, :2])[-1]) for c in covariances]
    turns = [float(c[2, 2]) for c in covariances]
    variance = sum(positions) + turns[0] * distance(middle, end) ** 2
    information: Array = np.diag([1.0 / variance, 1.0 / variance, 1.0 / sum(turns)])
    return information


def _information(covariance: Array, heading: float) -> Array:
    """Return the information of a pose with a covariance in the map, in the frame of the pose."""
    floor = np.diag([_LEAST_SD_M**2, _LEAST_SD_M**2, _LEAST_SD_RAD**2])
    return np.asarray(np.linalg.inv(turned(covariance, heading) + floor), np.float64)


def _seen_blocks(scan: PosedScan, blocks: Collection[Block]) -> frozenset[Block]:
    """Return the blocks that a scan sees: no ray to their middle ends clearly before it."""
    rays = scan.rays
    count = len(rays.ranges)
    if not blocks or count < 2:
        return frozenset()
    keys = np.array(sorted(blocks))
    offset = (keys + 0.5) * BLOCK_M - scan.pose[:2]
    ranges = np.hypot(offset[:, 0], offset[:, 1])
    first, last = float(rays.angles[0]), float(rays.angles[-1])
    middle, step = 0.5 * (first + last), (last - first) / (count - 1)
    bearings = np.arctan2(offset[:, 1], offset[:, 0]) - scan.pose[2]
    index = np.rint(wrap_all(bearings - middle) / step + 0.5 * (count - 1)).astype(np.int64)
    inside = (index >= 0) & (index < count) & (ranges < min(_SEEN_M, rays.reach))
    measured = rays.ranges[np.clip(index, 0, count - 1)]
    with np.errstate(invalid="ignore"):
        seen = inside & (measured >= ranges - _BEFORE_M)
    return frozenset((column, row) for column, row in keys[seen].tolist())
