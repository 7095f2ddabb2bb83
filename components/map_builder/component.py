"""The component MapBuilder: owns the visual map and the grid map, and their files."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    RateLimitedLog,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.map_builder.config import MapBuilderConfig
from cairn.components.map_builder.grid_keeper import GridKeeper
from cairn.components.map_builder.grid_updates import GridUpdates
from cairn.components.map_builder.keeper import MapKeeper, NumberedChange
from cairn.components.map_builder.messages import change_message, evidence_of, map_message
from cairn.components.map_builder.objects import Kind
from cairn.components.map_builder.posed_scans import PosedScans
from cairn.components.map_builder.rules import rule_named
from cairn.components.map_builder.store import open_map
from cairn.planar.grid import map_message as grid_message
from cairn.planar.map_file import read_map
from cairn.planar.messages import planar_pose
from cairn.planar.odometry import OdometryChange
from cairn.schemas.cairn_msgs import ObjectEvidenceArray, VisualMap, VisualMapChange
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, Relocalization
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.visual_map.file import MapFileError

# A full map follows its updates after this [s], for readers that come later.
_FULL_MAP_S = 5.0
_SAVE_S = 10.0
# Evidence of no longer than this before a lost robot was found is on its way together with that.
_ON_THE_WAY_NS = 2 * SECOND


class MapBuilder(Component):
    """Keeps the visual map and the grid map true while the robot works.

    Judges each object of the visual map by the evidence for it; removes and registers. Changes the
    grid map by what the scanner sees, as long as the pose is sure.
    """

    config: MapBuilderConfig
    object_evidence: In[ObjectEvidenceArray] = In(qos=RELIABLE.with_depth(200), optional=True)
    relocalized: In[Relocalization] = In(optional=True)
    scan: In[LaserScan] = In(qos=SENSOR, optional=True)
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000), optional=True)
    localization: In[LocalizationEstimate] = In(optional=True)
    visual_map: Out[VisualMap] = Out(qos=LATCHED)
    visual_map_changes: Out[VisualMapChange] = Out(qos=RELIABLE.with_depth(100))
    map: Out[OccupancyGrid] = Out(qos=LATCHED)
    map_updates: Out[OccupancyGridUpdate] = Out(qos=RELIABLE.with_depth(50))

    _keeper: MapKeeper | None = None
    _grid: GridKeeper | None = None

    def on_configure(self) -> None:
        """Check the map files, so that a wrong one is told of before anything moves."""
        config = self.config
        if config.map_file is not None:
            open_map(config.map_file, read_only=True).close()
        if config.grid_file is not None:
            read_map(config.grid_file)
        self._scans = PosedScans(
            config.mount.pose, config.scans_per_s, config.least_health, config.most_spread
        )
        self._updates = GridUpdates()
        self._warnings = RateLimitedLog(self.log)
        self._full_map_at = self._saved_at = 0
        self._found_at = -_ON_THE_WAY_NS

    def on_activate(self) -> None:
        """Open the maps and publish them, if it is known what time it is."""
        if self.clock.now() > 0:
            self._open_both()

    def on_deactivate(self) -> None:
        """Commit what is left."""
        if self._grid is not None:
            self._save_grid(self._grid)
            self._grid = None
        if self._keeper is not None:
            keeper, self._keeper = self._keeper, None
            keeper.close()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - any error ends it
        """Let go of the file; what was committed is safe."""
        if self._keeper is not None:
            keeper, self._keeper = self._keeper, None
            keeper.abandon()
        return False

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """Files cannot be exchanged under a map in use."""
        raise ParameterRejected("the map builder takes its parameters when it is configured")

    @on("object_evidence")
    def judge(self, frame: ObjectEvidenceArray) -> None:
        """Take one frame's evidence."""
        keeper = self._open()
        stamp_ns = to_ns(frame.header.stamp)
        # What a lost robot made of things may come after the word that it was lost.
        of_lost = 0 <= self._found_at - stamp_ns <= _ON_THE_WAY_NS
        if keeper is not None and self.config.update_objects and not of_lost:
            self._tell(stamp_ns, *keeper.apply(stamp_ns, evidence_of(frame)))

    @on("relocalized")
    def take_back(self, found: Relocalization) -> None:
        """Undo what the robot judged and drew while it was lost."""
        keeper, grid = self._open(), self._open_grid()
        stamp_ns = self._found_at = to_ns(found.header.stamp)
        since_ns = max(to_ns(found.confirmed_until), stamp_ns - round(self.config.undo_s * SECOND))
        if keeper is not None:
            self._tell(stamp_ns, *keeper.take_back(stamp_ns, since_ns))
        if grid is not None:
            window = grid.take_back(since_ns / SECOND)
            self._updates.add(window)
            if window is not None:
                self.log.info(
                    "the robot was lost: the grid map is again as it was %.0f s ago",
                    (stamp_ns - since_ns) / SECOND,
                )

    @on("odom")
    def follow(self, odom: Odometry) -> None:
        """Remember how the robot moved while its scanner swept."""
        stamp_ns = to_ns(odom.header.stamp)
        if self._scans.moved(stamp_ns, planar_pose(odom.pose.pose)) is OdometryChange.RESET:
            self.log.warning("odometry on %s went back in time: begun anew", self.odom.topic)

    @on("scan")
    def look(self, scan: LaserScan) -> None:
        """Keep a scan until its pose has come."""
        self._scans.scanned(scan)

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Integrate the scan that gave a reliable pose into the grid map."""
        grid = self._open_grid()
        if grid is None or not self.config.update_grid:
            return
        waits = self._scans.waiting
        ready = self._scans.ready(estimate)
        if bool(self._scans.waiting) != bool(waits):
            if self._scans.waiting:
                self.log.info("the grid map waits: %s", self._scans.waiting)
            else:
                self.log.info("the grid map is kept up to date again")
        if ready is not None:
            window = grid.integrate(ready.stamp_ns / SECOND, ready.pose, ready.rays)
            self._updates.add(window)

    @every(hz=1)
    def save(self) -> None:
        """Open the maps once time is known; commit and tell what changed in the last second."""
        now = self.clock.now()
        if now <= 0:
            return
        self._open_both()
        if self._keeper is not None:
            self._save_evidence(self._keeper)
        if self._grid is None:
            return
        self._tell_grid(now)
        if now - self._saved_at >= _SAVE_S * SECOND:
            self._saved_at = now
            self._save_grid(self._grid)

    def _save_evidence(self, keeper: MapKeeper) -> None:
        try:
            keeper.save_pending()
        except MapFileError as error:
            # It stays pending, and goes with the next change, which is told once it is kept.
            self._warnings.warn("evidence", f"evidence of objects is not kept yet: {error}")

    def _save_grid(self, grid: GridKeeper) -> None:
        try:
            grid.save(self.clock.now())
        except CairnError as error:
            # The map that the robot drives by is in memory, and what was told of it holds.
            self._warnings.warn("grid", f"the grid map is not kept: {error}")

    def _open_both(self) -> None:
        self._open()
        self._open_grid()

    def _open(self) -> MapKeeper | None:
        config = self.config
        if self._keeper is None and config.map_file is not None:
            now = self.clock.now()
            self._keeper = MapKeeper(
                config.map_file,
                config.working_copy,
                now,
                config.learn_unknown,
                rule_named(config.rule),
                config.undo_s,
            )
            self._tell(now, True, [])
        return self._keeper

    def _open_grid(self) -> GridKeeper | None:
        config = self.config
        if self._grid is None and config.grid_file is not None:
            now = self.clock.now()
            self._grid = GridKeeper(
                config.grid_file, config.grid_copy, now, config.settle_s, config.undo_s
            )
            self._saved_at = now
            self._tell_full_map(now)
        return self._grid

    def _tell_grid(self, now: int) -> None:
        assert self._grid is not None
        update = self._updates.take(self._grid.occupancy.cells)
        if update is not None:
            header = Header(stamp=from_ns(now), frame_id="map")
            self.map_updates.publish(
                OccupancyGridUpdate(
                    header=header,
                    x=update.column,
                    y=update.row,
                    width=update.values.shape[1],
                    height=update.values.shape[0],
                    data=update.values.ravel(),
                )
            )
        if self._updates.untold and now - self._full_map_at >= _FULL_MAP_S * SECOND:
            self._tell_full_map(now)

    def _tell_full_map(self, now: int) -> None:
        assert self._grid is not None
        self._full_map_at = now
        self._updates.told()
        stamp = from_ns(now)
        header = Header(stamp=stamp, frame_id="map")
        self.map.publish(grid_message(header, self._grid.occupancy.grid, stamp))

    def _tell(self, stamp_ns: int, touched: bool, changes: Sequence[NumberedChange]) -> None:
        keeper = self._keeper
        if keeper is None or not (touched or changes):
            return
        stamp = from_ns(stamp_ns)
        for version, change in changes:
            level = logging.DEBUG if change.kind is Kind.REFINED else logging.INFO
            self.log.log(
                level, "object %d %s: %s", change.object_id, change.kind.name, change.reason
            )
            self.visual_map_changes.publish(change_message(stamp, version, change))
        self.visual_map.publish(map_message(stamp, keeper.version, keeper.objects))
