"""The component GraphKeeper: permanent changes of the building go into the graph of its map."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from types import MappingProxyType
from typing import Any

import numpy as np

from cairn import (
    LATCHED,
    RELIABLE,
    SENSOR,
    CairnError,
    Component,
    In,
    RateLimitedLog,
    RetriedSave,
    every,
    on,
)
from cairn.components.slam.graph_history import (
    GraphHistory,
    copy_graph,
    graph_digest,
    read_log,
)
from cairn.components.slam.keeper_config import GraphKeeperConfig
from cairn.components.slam.lifelong import LifelongMap
from cairn.planar.grid import grid_of
from cairn.planar.messages import planar_covariance
from cairn.planar.posed_scans import PosedScans
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.system.working_copy import is_reusable, set_aside


class GraphKeeper(Component):
    """Keeps the graph of the map up to date while localizer and map builder work on the grid map.

    Where the map builder has repaired the grid map permanently, scans of the place go into the
    graph, and what it had there is retired.

    If the obstacles of the grid map differ from those of the graph for `permanent_s`, and scans
    with reliable poses still show the difference, these scans become part of the graph. The time
    goes on while the robot is off. There, only these and later scans count, in patches of 0.1 m. An
    obstacle that a user has drawn into the grid map, such as glass, stays in the grid map alone.

    The graph has at most `keyframes_per_m2` keyframes per known square meter, and as many retired
    ones.
    """

    # A graph cannot be replaced while it is in use.
    live_parameters = frozenset()
    config: GraphKeeperConfig
    request_roles = MappingProxyType({"status": "view"})

    map: In[OccupancyGrid] = In(qos=LATCHED)
    map_updates: In[OccupancyGridUpdate] = In(qos=RELIABLE.with_depth(50))
    localization: In[LocalizationEstimate] = In(qos=RELIABLE.with_depth(200))
    scan: In[LaserScan] = In(qos=SENSOR.with_depth(20))
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))

    _history: GraphHistory | None = None
    _graph: LifelongMap | None = None
    _newest_map: OccupancyGrid | None = None

    def on_configure(self) -> None:
        """Check the graph, so that a wrong one is reported before anything moves."""
        config = self.config
        graph_digest(config.graph_file)
        self._scans = PosedScans(
            config.mount.pose, config.scans_per_s, config.least_health, config.most_spread
        )
        self._warnings = RateLimitedLog(self.log)
        self._saved = RetriedSave(self, "graph")

    def on_deactivate(self) -> None:
        """Close the graph; all changes are in it."""
        self._close()

    def on_error(self, _: Exception) -> bool:
        """Close the graph; committed changes are safe."""
        self._close()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `status` with figures of the graph."""
        if verb != "status" or arguments:
            return super().on_request(verb, arguments)
        graph = self._graph
        if graph is None:
            raise CairnError(f"{self.name}: has no map yet: none was received on {self.map.topic}")
        return {
            "version": graph.version,
            "keyframes": graph.keyframes,
            "pending": graph.pending,
        }

    @on("map")
    def on_map(self, message: OccupancyGrid) -> None:
        """Compare the graph with a new grid map."""
        self._newest_map = message
        self._compare_map()

    @on("map_updates")
    def on_map_update(self, update: OccupancyGridUpdate) -> None:
        """Compare the graph with a changed window of the grid map."""
        if self._graph is not None:
            values = update.data.reshape(update.height, update.width)
            self._graph.update_map(update.y, update.x, values)

    @on("odom")
    def on_odometry(self, odom: Odometry) -> None:
        """Store the robot's motion, which distorts the sweeps of scans."""
        self._scans.add_odometry(odom, self.odom.topic, self.log)

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Keep a scan until its pose arrives."""
        self._scans.add_scan(scan)

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Consider the scan that gave a reliable pose."""
        ready = self._scans.ready(estimate)
        if ready is not None and self._graph is not None:
            self._graph.add_scan(ready, np.array(planar_covariance(estimate.pose)))

    @every(hz=1)
    def update_graph(self) -> None:
        """Make the changes that are due."""
        self._compare_map()
        graph = self._graph
        if graph is None:
            return
        if graph.is_of_other_building:
            self._warnings.warn(
                "other building",
                f"graph not changed: most obstacles of the map on {self.map.topic} are not in "
                f"{self.config.graph_file}; give the graph of that map",
            )
            return
        # If it fails, the graph stays as it is on the disk, and the change is tried again.
        self._saved.attempt(
            lambda: self._work(graph), lambda: "the next process finds the change again"
        )

    def _work(self, graph: LifelongMap) -> None:
        change = graph.work(self.clock.now())
        if change is not None:
            self.log.info(
                "changed the graph: version %d, %s at (%.2f m, %.2f m): %d cells added, %d removed",
                graph.version,
                change.kind,
                change.x,
                change.y,
                change.added,
                change.removed,
            )

    def _compare_map(self) -> None:
        """Give the newest map to the graph, once that is open: a full disk delays it."""
        if self._newest_map is None:
            return
        if self._graph is None and not self._saved.attempt(
            self._open, lambda: "no change of the map goes into the graph"
        ):
            return
        assert self._graph is not None
        message, self._newest_map = self._newest_map, None
        try:
            self._graph.set_map(grid_of(message))
        except (CairnError, ValueError) as error:
            self._warnings.warn("map", f"map on {self.map.topic} ignored: {error}")

    def _open(self) -> None:
        config = self.config
        if not self._is_reusable():
            copy_graph(config.graph_file, config.working_copy)
        with ExitStack() as closing:
            history = closing.enter_context(GraphHistory(config.working_copy))
            graph = LifelongMap(history, config.permanent_s, config.keyframes_per_m2)
            closing.pop_all()
        self._history, self._graph = history, graph
        self.log.info("opened the graph: version %d, %d keyframes", graph.version, graph.keyframes)

    def _is_reusable(self) -> bool:
        copy = self.config.working_copy
        if not copy.exists():
            return False
        try:
            log = read_log(copy)
        except CairnError as error:
            set_aside(copy, self.log, error)
            return False
        same = log.origin == graph_digest(self.config.graph_file)
        ahead = self.time_may_repeat and log.last_stamp_ns > self.clock.now()
        return is_reusable(copy, self.log, same=same, ahead=ahead)

    def _close(self) -> None:
        self._graph = self._newest_map = None
        if self._history is not None:
            self._history.close()
            self._history = None
