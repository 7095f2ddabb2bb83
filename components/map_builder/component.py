"""The component MapBuilder: owns the visual map, the grid map, its zones, and their files."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    In,
    Out,
    RateLimitedLog,
    RetriedSave,
    every,
    from_ns,
    has_passed,
    on,
    to_ns,
)
from cairn.components.map_builder.cell_messages import (
    CellExchange,
    cell_exchange,
    decision_message,
)
from cairn.components.map_builder.cell_record import Tiles
from cairn.components.map_builder.config import MapBuilderConfig
from cairn.components.map_builder.evidence_chain import explain
from cairn.components.map_builder.grid_keeper import GridKeeper, PendingUpdates, grid_digest
from cairn.components.map_builder.landmark_map import LandmarkKeeper, NumberedChange
from cairn.components.map_builder.landmark_messages import (
    LandmarkExchange,
    change_message,
    contribution_message,
    evidence_of,
    landmark_exchange,
    landmark_of,
    map_message,
)
from cairn.components.map_builder.landmark_verdicts import Rule, judge
from cairn.components.map_builder.other_robots import OtherRobots
from cairn.components.map_builder.record_exchange import contributor_messages
from cairn.components.map_builder.zone_keeper import CHANGES, ZoneKeeper
from cairn.planar.grid import map_message as grid_message
from cairn.planar.map_file import read_map
from cairn.planar.messages import planar_pose
from cairn.planar.posed_scans import PosedScans
from cairn.schemas.cairn_msgs import (
    MOST_DECISIONS,
    ObjectEvidenceArray,
    SharedCells,
    SharedLandmarks,
    VisualMap,
    VisualMapChange,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, Relocalization, Zones
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.landmarks import (
    FARTHEST_M,
    ChangeKind,
)
from cairn.visual_map.shared_record import check_robot_name
from cairn.visual_map.sqlite_file import digest_of

# A full map follows its updates after this [s], for readers that start later, and the grid map is
# saved after this [s]: what a power cut loses. Chosen by hand; `lab/constants.yaml` has the
# effect of half and double.
_FULL_MAP_S = 5.0
_SAVE_S = 10.0
# Evidence that is at most this much older than a relocalization was made by the lost robot; the
# localizer drops observations that are later than 1 s.
_IN_TRANSIT_NS = 2 * SECOND
_SHARED_BYTES: Final = 256 << 10
# A position that is older than this [ns] is not published: the robot may be elsewhere.
_POSITION_NS: Final = 2 * SECOND
# Steps of an object's history in one reply, by default and at most: 1 MiB would have some 3,000.
_STEPS: Final = 30
_MOST_STEPS: Final = 1000
# Arguments of the requests that change zones: those needed, and all.
_ARGUMENTS: Final = {
    "set_zones": ({"features"}, {"features"}),
    "add_zone": ({"feature"}, {"feature", "replace"}),
    "remove_zone": ({"name"}, {"name"}),
}


class MapBuilder(Component):
    """Keeps the visual map and the grid map up to date while the robot works.

    Judges each landmark by the evidence about it: removes moved ones, registers them at their new
    positions. Integrates scans into the grid map while the robot's pose is reliable. Keeps the
    zones that users draw on the map.
    """

    # Files cannot be replaced while their map is in use.
    live_parameters = frozenset()
    config: MapBuilderConfig
    request_roles = MappingProxyType(
        {
            "why": "view",
            "zones": "view",
            "set_zones": "operate",
            "add_zone": "operate",
            "remove_zone": "operate",
        }
    )
    request_max_bytes = MappingProxyType({"set_zones": 256 << 10, "add_zone": 256 << 10})

    object_evidence: In[ObjectEvidenceArray] = In(qos=RELIABLE.with_depth(200), optional=True)
    accepted_objects: In[VisualMap] = In(qos=LATCHED, optional=True)
    relocalized: In[Relocalization] = In(optional=True)
    others: In[SharedLandmarks] = In(
        qos=LATCHED.with_depth(200), optional=True, max_bytes=_SHARED_BYTES
    )
    others_cells: In[SharedCells] = In(
        qos=LATCHED.with_depth(200), optional=True, max_bytes=_SHARED_BYTES
    )
    scan: In[LaserScan] = In(qos=SENSOR, optional=True)
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000), optional=True)
    localization: In[LocalizationEstimate] = In(qos=RELIABLE.with_depth(200), optional=True)
    visual_map: Out[VisualMap] = Out(qos=LATCHED)
    visual_map_changes: Out[VisualMapChange] = Out(qos=RELIABLE.with_depth(100))
    shared: Out[SharedLandmarks] = Out(qos=LATCHED)
    shared_cells: Out[SharedCells] = Out(qos=LATCHED)
    zones: Out[Zones] = Out(qos=LATCHED)
    map: Out[OccupancyGrid] = Out(qos=LATCHED)
    map_updates: Out[OccupancyGridUpdate] = Out(qos=RELIABLE.with_depth(50))

    _landmarks: LandmarkKeeper | None = None
    _grid: GridKeeper | None = None
    _zones: ZoneKeeper | None = None
    _exchange: LandmarkExchange | None = None
    _cell_exchange: CellExchange | None = None
    _position: LocalizationEstimate | None = None
    _zones_published = False

    def on_configure(self) -> None:
        """Check the map files, so that a wrong one is reported before anything moves."""
        config = self.config
        if config.map_file is not None:
            open_landmarks(config.map_file, read_only=True).close()
        self._exchange = self._cell_exchange = None
        if config.share:
            self._check_sharing()
        if config.share and config.map_file is not None:
            self._exchange = landmark_exchange(self.robot, digest_of(config.map_file))
        if config.grid_file is not None:
            grid = read_map(config.grid_file, self.log.warning)
            if config.share:
                rows, columns = grid.values.shape
                self._cell_exchange = cell_exchange(
                    self.robot, grid_digest(grid), Tiles((rows, columns))
                )
        self._zones = None
        if config.zones_file is not None:
            self._zones = ZoneKeeper(config.zones_file, self.log)
        self._scans = PosedScans(
            config.mount.pose, config.scans_per_s, config.least_health, config.most_spread
        )
        self._other_robots, self._position = OtherRobots(), None
        self._updates = PendingUpdates()
        self._warnings = RateLimitedLog(self.log)
        self._saved_landmarks = RetriedSave(self, "visual map")
        self._saved_grid = RetriedSave(self, "grid map")
        self._saved_zones = RetriedSave(self, "zones")
        self._full_map_at = self._saved_at = 0
        self._relocalized_at = -_IN_TRANSIT_NS

    def _check_sharing(self) -> None:
        config = self.config
        landmarks = ("shared", self.shared.topic, "others", self.others.topic)
        cells = ("shared_cells", self.shared_cells.topic, "others_cells", self.others_cells.topic)
        for given, ports, topic in (
            (config.map_file, landmarks, "/fleet/landmarks"),
            (config.grid_file, cells, "/fleet/cells"),
        ):
            shared, sent, others, received = ports
            if given is not None and sent != received:
                raise CairnError(
                    f"{self.name}: share: its ports {shared} ({sent}) and {others} ({received}) "
                    f"have different topics; give both the same one, such as {topic}, under "
                    "`topics`"
                )
        try:
            check_robot_name(self.robot)
        except ValueError as error:
            raise CairnError(
                f"{self.name}: share: {error}; give it one of at most 63 characters, `robot` in "
                "the deployment"
            ) from error

    def on_activate(self) -> None:
        """Open the maps and publish them, if the clock has started."""
        if self._zones is not None:
            self.report_problem("damaged zones", self._zones.problem)
        if self.clock.now() > 0:
            self._open_both()

    def on_deactivate(self) -> None:
        """Save the maps."""
        if self._zones is not None:
            self._save_zones(self._zones, now=True)
            self._zones_published = False
        if self._grid is not None:
            self._save_grid(self._grid, now=True)
            self._grid = None
        if self._landmarks is not None:
            keeper, self._landmarks = self._landmarks, None
            self._save_landmarks(keeper, now=True)
            keeper.close()

    def on_error(self, _: Exception) -> bool:
        """Close the files; committed changes are safe."""
        if self._landmarks is not None:
            keeper, self._landmarks = self._landmarks, None
            keeper.close()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `why` with the chain of evidence about `object` (number or name), as far as saved.

        It has the `last` newest steps, by default 30. `zones` returns the zones as GeoJSON features
        with their version; `set_zones` (`features`), `add_zone` (`feature`, and the name of one to
        `replace`) and `remove_zone` (`name`) change them.
        """
        if verb == "zones" and not arguments:
            return self._zones_in_force().describe()
        if verb in CHANGES and _has_arguments_of(verb, set(arguments)):
            return self._change_zones(verb, arguments)
        if verb != "why" or not {"object"} <= set(arguments) <= {"object", "last"}:
            return super().on_request(verb, arguments)
        called, last = str(arguments["object"]), arguments.get("last", _STEPS)
        if type(last) is not int or not 1 <= last <= _MOST_STEPS:
            raise CairnError(
                f"{self.name}: why: last {last!r} is not a number of steps; give 1 to {_MOST_STEPS}"
            )
        keeper = self._open_landmarks() if self.clock.now() > 0 else None
        if keeper is None or keeper.store is None:
            raise CairnError(
                f"{self.name}: has no visual map to read now; check the parameter map_file, and "
                "`cairn ps` for what keeps the map from being saved"
            )
        return explain(keeper.store, called, last)

    def _zones_in_force(self) -> ZoneKeeper:
        if self._zones is None:
            raise CairnError(
                f"{self.name}: has no file for zones; set its parameter zones_file, such as "
                "MAP.zones.geojson beside the map"
            )
        if not self._zones_published:
            raise CairnError(f"{self.name}: is not active yet; try again")
        return self._zones

    def _change_zones(self, verb: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Make a change, on the disk before it is published.

        If the disk takes no data, it is in force all the same, and saved later.
        """
        keeper = self._zones_in_force()
        keeper.change(verb, arguments)
        self._save_zones(keeper, now=True)
        self.log.info("zones changed (version %d): %d zones", keeper.version, len(keeper.zones))
        self._publish_zones(keeper)
        return {
            "version": keeper.version,
            "zones": len(keeper.zones),
            "saved": keeper.is_saved,
            "file": str(keeper.file),
        }

    @on("object_evidence")
    def on_object_evidence(self, message: ObjectEvidenceArray) -> None:
        """Apply the evidence of one image to the landmarks."""
        keeper = self._open_landmarks()
        stamp_ns = to_ns(message.header.stamp)
        # Evidence of a lost robot may arrive after the message that it was lost.
        while_lost = 0 <= self._relocalized_at - stamp_ns <= _IN_TRANSIT_NS
        if keeper is not None and self.config.update_objects and not while_lost:
            counted, changes = keeper.apply(stamp_ns, evidence_of(message))
            if changes:  # on the disk before they are published; other evidence once a second
                self._save_landmarks(keeper)
            self._publish(stamp_ns, counted, changes)
            if changes:
                self._share(keeper)
            if keeper.refused:
                self._warn_of_refused(keeper, keeper.refused[-1])

    @on("others")
    def on_others(self, message: SharedLandmarks) -> None:
        """Take in what another robot with the same map has found out; prepare what it lacks."""
        keeper, exchange = self._open_landmarks(), self._exchange
        if keeper is None or exchange is None or keeper.sharing is None:
            return
        now, record = self.clock.now(), keeper.sharing.record
        if not self._is_of_another_robot(message, exchange, keeper.sharing.next_version):
            return
        rejected = exchange.rejected
        accepted = exchange.accept(record, message.contributions, now)
        matters, changes = keeper.merge(now, accepted)
        exchange.rejected += len(keeper.refused)
        if keeper.refused:
            exchange.reason = f"about object {keeper.refused[0]}: the visual map is full"
        self._warn_of_rejected(message, exchange, rejected)
        if changes:
            self._save_landmarks(keeper)
        self._publish(now, matters, changes)
        exchange.compare(record, message.robot, message.contributors, accepted, now)

    @on("others_cells")
    def on_others_cells(self, message: SharedCells) -> None:
        """Take in what another robot has decided about cells; prepare what it lacks."""
        grid, exchange = self._open_grid(), self._cell_exchange
        if grid is None or exchange is None or grid.sharing is None:
            return
        now, record = self.clock.now(), grid.sharing.record
        if not self._is_of_another_robot(message, exchange, grid.sharing.newest_ns + 1):
            return
        self._other_robots.note(message.robot, message.x, message.y, message.radius, now)
        rejected = exchange.rejected
        accepted = exchange.accept(record, message.decisions, now)
        self._warn_of_rejected(message, exchange, rejected)
        windows = grid.merge(accepted)
        for window in windows:
            self._updates.add(window)
        x, y = self._where(now)
        if windows and not math.isnan(x):
            self._updates.add(grid.free_own_place(x, y, self.config.radius, now))
        if windows:
            self._publish_grid_update(now)
        exchange.compare(record, message.robot, message.contributors, accepted, now)

    def _is_of_another_robot(
        self,
        message: SharedLandmarks | SharedCells,
        exchange: LandmarkExchange | CellExchange,
        next_version: int,
    ) -> bool:
        """Return whether a message is of another robot with the same map; warn if it should be."""
        if message.robot == self.robot:
            own = {one.robot: one.newest for one in message.contributors}
            if own.get(self.robot, 0) >= next_version:
                self._warnings.warn(
                    "robot's name",
                    f"another robot has the name {self.robot}: it shares contributions that this "
                    "one has not made; give each robot its own name (`robot` in the deployment)",
                )
            return False
        if message.map != exchange.map_digest:
            parameter = "map_file" if isinstance(message, SharedLandmarks) else "grid_file"
            self._warnings.warn(
                f"another {parameter}",
                f"robot {message.robot!r} has another map (digest {message.map[:12]!r}, not "
                f"{exchange.map_digest[:12]!r}): nothing of it is shared; give both the same "
                f"{parameter}",
            )
            return False
        return True

    def _warn_of_rejected(
        self,
        message: SharedLandmarks | SharedCells,
        exchange: LandmarkExchange | CellExchange,
        before: int,
    ) -> None:
        if exchange.rejected > before:
            self._warnings.warn(
                "contribution", f"rejected contribution from {message.robot!r}, {exchange.reason}"
            )

    @on("accepted_objects")
    def on_accepted_objects(self, message: VisualMap) -> None:
        """Add the accepted proposals that are not in the map yet."""
        keeper = self._open_landmarks()
        if keeper is None or not self.config.update_objects:
            return
        stamp_ns = self.clock.now()
        changes = keeper.add(
            stamp_ns, map(landmark_of, message.objects), "accepted as a new landmark"
        )
        if changes:  # on the disk before they are published
            self._save_landmarks(keeper)
        self._publish(stamp_ns, bool(changes), changes)
        if keeper.refused:
            self._warnings.warn(
                "accepted object",
                f"refused the accepted object {keeper.refused[-1]}: the visual map is full "
                f"(max_landmarks is {self.config.max_landmarks}), or its name or place is not "
                "valid",
            )

    @on("relocalized")
    def on_relocalized(self, message: Relocalization) -> None:
        """Undo the changes that were made while the robot was lost."""
        keeper, grid = self._open_landmarks(), self._open_grid()
        stamp_ns = self._relocalized_at = to_ns(message.header.stamp)
        earliest_ns = stamp_ns - round(self.config.undo_s * SECOND)
        since_ns = max(to_ns(message.confirmed_until), earliest_ns)
        if keeper is not None:
            restored, changes = keeper.undo(stamp_ns, since_ns)
            self._save_landmarks(keeper)
            self._publish(stamp_ns, restored, changes)
            self._share(keeper)
        if grid is not None:
            window = grid.undo(since_ns / SECOND, stamp_ns)
            self._updates.add(window)
            if window is not None:
                self.log.info(
                    "undid the changes of the grid map of the last %.0f s: the robot was lost",
                    (stamp_ns - since_ns) / SECOND,
                )

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
        """Integrate the scan that gave a reliable pose into the grid map."""
        if estimate.located:
            self._position = estimate
        grid = self._open_grid()
        if grid is None or not self.config.update_grid:
            return
        was_waiting = self._scans.waiting
        ready = self._scans.ready(estimate)
        if bool(self._scans.waiting) != bool(was_waiting):
            if self._scans.waiting:
                self.log.info("paused updates of the grid map: %s", self._scans.waiting)
            else:
                self.log.info("resumed updates of the grid map")
        if ready is not None:
            rays = self._other_robots.out_of(ready.rays, ready.pose, self.clock.now())
            window = grid.integrate(ready.stamp_ns / SECOND, ready.pose, rays)
            self._updates.add(window)

    @every(hz=2)
    def share_changes(self) -> None:
        """Publish what this robot has found out about cells for other robots, and for itself."""
        if self._grid is not None and self._share_cells(self._grid, changes_only=True):
            self._publish_grid_update(self.clock.now())

    @every(hz=1)
    def save_and_publish(self) -> None:
        """Commit evidence and publish grid updates; open the maps once the clock has started."""
        now = self.clock.now()
        if now <= 0:
            return
        self._open_both()
        if self._zones is not None:
            self._save_zones(self._zones)
        if self._landmarks is not None:
            self._save_landmarks(self._landmarks)
            self._share(self._landmarks, answers=True)
        if self._grid is None:
            return
        self._share_cells(self._grid)
        self._publish_grid_update(now)
        if has_passed(_SAVE_S, self._saved_at, now):
            self._save_grid(self._grid)

    def _warn_of_refused(self, keeper: LandmarkKeeper, object_id: int) -> None:
        known, most = {one.object_id for one in keeper.landmarks}, self.config.max_landmarks
        if len(known) >= most and object_id not in known:
            self._warnings.warn(
                "full map",
                f"visual map is full: it has {len(known)} landmarks, and max_landmarks is {most}; "
                f"did not learn object {object_id}",
            )
        else:
            self._warnings.warn(
                "far object",
                f"refused evidence about object {object_id}: its position would be farther than "
                f"{FARTHEST_M:g} m",
            )

    def _share(self, keeper: LandmarkKeeper, *, answers: bool = False) -> None:
        """Publish what this robot has found out since the last time, and a summary of the rest."""
        exchange = self._exchange
        if exchange is None or keeper.sharing is None:
            return
        own, record = keeper.take_contributions(), keeper.sharing.record
        for part in exchange.in_messages(own + (exchange.take_answers() if answers else [])):
            self.shared.publish(
                SharedLandmarks(
                    header=Header(stamp=from_ns(self.clock.now()), frame_id="map"),
                    robot=self.robot,
                    map=exchange.map_digest,
                    map_version=keeper.version,
                    landmarks=len(keeper.landmarks),
                    rejected=exchange.rejected,
                    contributors=contributor_messages(record),
                    contributions=tuple(map(contribution_message, part)),
                )
            )

    def _where(self, now: int) -> tuple[float, float]:
        """Return the robot's position x, y [m] in the map; NaN if it is not known at `now`."""
        known = self._position
        if known is None or now - to_ns(known.header.stamp) > _POSITION_NS:
            return math.nan, math.nan
        x, y, _ = planar_pose(known.pose.pose)
        return x, y

    def _share_cells(self, grid: GridKeeper, *, changes_only: bool = False) -> bool:
        """Publish what this robot has decided since the last time, and a summary of the rest.

        With `changes_only`, it does so only if it has decided anything. Returns whether it did.
        """
        exchange, now = self._cell_exchange, self.clock.now()
        if exchange is None or grid.sharing is None:
            return False
        grid.contribute()
        sent = grid.sharing.take_decisions(MOST_DECISIONS // 4)
        if changes_only and not sent:
            return False
        if not changes_only:
            sent += exchange.take_answers(MOST_DECISIONS - len(sent))
        x, y = self._where(now)
        self.shared_cells.publish(
            SharedCells(
                header=Header(stamp=from_ns(now), frame_id="map"),
                robot=self.robot,
                map=exchange.map_digest,
                cells=grid.sharing.changed_cells,
                rejected=exchange.rejected,
                x=x,
                y=y,
                radius=self.config.radius,
                contributors=contributor_messages(grid.sharing.record),
                decisions=tuple(map(decision_message, sent)),
            )
        )
        return True

    def _save_landmarks(self, keeper: LandmarkKeeper, *, now: bool = False) -> None:
        # If it fails, the robot goes on with the landmarks in memory.
        if not keeper.is_saved:
            self._saved_landmarks.attempt(keeper.save, lambda: keeper.unsaved, now=now)

    def _save_grid(self, grid: GridKeeper, *, now: bool = False) -> None:
        # If it fails, the robot goes on with the map in memory; updates remain valid.
        at = self.clock.now()
        lost = "the changes of the grid map since its last copy are lost"
        if self._saved_grid.attempt(lambda: grid.save(at), lambda: lost, now=now):
            self._saved_at = at

    def _save_zones(self, keeper: ZoneKeeper, *, now: bool = False) -> None:
        if not keeper.is_saved:
            lost = f"the zones of version {keeper.version} are lost"
            self._saved_zones.attempt(keeper.save, lambda: lost, now=now)

    def _open_both(self) -> None:
        # Zones first, so that no path is planned on the map without them.
        if self._zones is not None and not self._zones_published:
            self._publish_zones(self._zones)
        self._open_landmarks()
        self._open_grid()

    def _open_landmarks(self) -> LandmarkKeeper | None:
        config = self.config
        if self._landmarks is None and config.map_file is not None:
            now = self.clock.now()
            self._landmarks = LandmarkKeeper(
                config.map_file,
                config.working_copy,
                now if self.time_may_repeat else None,
                config.max_landmarks if config.learn_unknown else 0,
                self.rule(),
                config.undo_s,
                None if self._exchange is None else self.robot,
            )
            self._publish(now, True, [])
        return self._landmarks

    def rule(self) -> Rule:
        """Return how evidence changes the landmarks."""
        return judge

    def _open_grid(self) -> GridKeeper | None:
        config = self.config
        if self._grid is None and config.grid_file is not None:
            now = self.clock.now()
            self._grid = GridKeeper(
                config.grid_file,
                config.grid_copy,
                now if self.time_may_repeat else None,
                config.settle_s,
                config.undo_s,
                None if self._cell_exchange is None else self.robot,
            )
            self._saved_at = now
            self._publish_full_map(now)
        return self._grid

    def _publish_zones(self, keeper: ZoneKeeper) -> None:
        self._zones_published = True
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        self.zones.publish(Zones(header=header, version=keeper.version, zones=keeper.zones))

    def _publish_grid_update(self, now: int) -> None:
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
        is_due = has_passed(_FULL_MAP_S, self._full_map_at, now)
        if self._updates.full_map_is_outdated and is_due:
            self._publish_full_map(now)

    def _publish_full_map(self, now: int) -> None:
        assert self._grid is not None
        self._full_map_at = now
        self._updates.full_map_published()
        stamp = from_ns(now)
        header = Header(stamp=stamp, frame_id="map")
        self.map.publish(grid_message(header, self._grid.occupancy.grid, stamp))

    def _publish(self, stamp_ns: int, touched: bool, changes: Sequence[NumberedChange]) -> None:
        keeper = self._landmarks
        if keeper is None or not (touched or changes):
            return
        stamp = from_ns(stamp_ns)
        for version, change in changes:
            level = logging.DEBUG if change.kind is ChangeKind.REFINED else logging.INFO
            self.log.log(
                level, "object %d %s: %s", change.object_id, change.kind.name, change.reason
            )
            self.visual_map_changes.publish(change_message(stamp, version, change))
        self.visual_map.publish(map_message(stamp, keeper.version, keeper.landmarks))


def _has_arguments_of(verb: str, given: set[str]) -> bool:
    needed, allowed = _ARGUMENTS[verb]
    return needed <= given <= allowed
