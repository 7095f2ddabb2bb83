"""The component Slam: maps an unknown building, and localizes the robot in what it has mapped."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

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
from cairn.components.slam.config import SlamConfig
from cairn.components.slam.graph_file import (
    GraphFile,
    kept_path,
    read_graph,
    set_aside,
)
from cairn.components.slam.landmarks import write_landmarks
from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.quality import quality_of
from cairn.components.slam.tracking import Tracked
from cairn.planar.grid import OccupancyCells, map_message
from cairn.planar.map_file import write_map
from cairn.planar.messages import planar_pose, transform_message, with_covariance
from cairn.planar.odometry import (
    FASTEST_WHEELS,
    ODOMETRY_DISORDER_S,
    OdometryChange,
    OdometryHistory,
)
from cairn.planar.pose_tracker import sweep_of
from cairn.planar.posed_scans import HISTORY_S
from cairn.planar.poses import Pose, compose, inverse
from cairn.planar.scans import rays_of
from cairn.planar.waiting_scans import WaitingScans
from cairn.schemas.cairn_msgs import RecognizedObjectArray
from cairn.schemas.cairn_nav_msgs import NO_REASON, LocalizationEstimate, Reason, ReasonCode
from cairn.schemas.geometry_msgs import PoseWithCovariance, PoseWithCovarianceStamped
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.system.files import remove_side_files
from cairn.visual_map.observations import observations_of

# The graph is saved this often [s]: what a kill loses. As often, a full map follows its updates,
# for readers that start later.
_SAVE_S = 3.0
# Scans that are drawn per second, at about 1 ms each.
_DRAWN = 60
# The most health while scans have too few points, as in the localizer.
_MOST_WITHOUT_POINTS = 0.5


class Slam(Component):
    """Builds the grid map while the robot drives, and publishes the robot's pose in it.

    Replaces localizer and map_builder until the map is finished. The request `save` writes the map.
    """

    # The map would be of two kinds.
    live_parameters = frozenset()
    published_frames = frozenset({"odom"})
    config: SlamConfig
    request_roles = MappingProxyType({"save": "operate", "status": "view"})

    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    scan: In[LaserScan] = In(qos=SENSOR.with_depth(20))
    objects: In[RecognizedObjectArray] = In(optional=True)
    map: Out[OccupancyGrid] = Out(qos=LATCHED)
    map_updates: Out[OccupancyGridUpdate] = Out(qos=RELIABLE.with_depth(50))
    localization: Out[LocalizationEstimate] = Out(qos=RELIABLE.with_depth(50))
    pose: Out[PoseWithCovarianceStamped]
    tf: Out[TFMessage] = Out(qos=RELIABLE.with_depth(100))

    _file: GraphFile | None = None

    def on_configure(self) -> None:
        """Check the files, so that a wrong one is reported before anything moves."""
        config = self.config
        folder = config.map_file.parent
        if not folder.is_dir():
            raise CairnError(f"{folder}: no such folder to write the map to (map_file)")
        if config.map_file.suffix != ".yaml":
            raise CairnError(f"{config.map_file}: map_file must end in .yaml")
        if config.extend is not None:
            own = self._graph_file
            if config.extend.resolve() in (own.resolve(), kept_path(own).resolve()):
                raise CairnError(
                    f"{config.extend}: is where {self.name} keeps the graph of this run or of the "
                    "one before, so a new map replaces it; extend a copy of it (extend)"
                )
            read_graph(config.extend)
        # A restarted process continues the graph of this run, and of no earlier one.
        if self.restarts == 0 and (kept := set_aside(self._graph_file)) is not None:
            self.log.warning("kept the graph of an earlier run as %s", kept)
        self._warnings = RateLimitedLog(self.log)
        self._saved = RetriedSave(self, "map")
        self._saved_maps = RetriedSave(self, "grid map and visual map")
        self._has_landmarks = False
        self._history: OdometryHistory[int] = OdometryHistory(HISTORY_S * SECOND, FASTEST_WHEELS)
        self._waiting = WaitingScans(0.0)
        self._objects: deque[RecognizedObjectArray] = deque(maxlen=self.objects.qos.depth)
        self._mapper: Mapper | None = None
        self._drawing = MapGrid(config.resolution, config.reach)
        self._published_frame: tuple[object, ...] | None = None
        self._full_map_at = self._saved_at = 0
        self._full_map_is_outdated = False
        self._was_located = False

    def on_activate(self) -> None:
        """Continue the map, if the component was inactive for some time."""
        if self._mapper is not None:
            self._file, _ = GraphFile.open(self._graph_file)

    def on_deactivate(self) -> None:
        """Save the map."""
        if self._mapper is not None and self._mapper.keyframes:
            self._save(self._mapper)
            self._warn_unless_extended(self._mapper)
        self._close()

    def on_error(self, _: Exception) -> bool:
        """Close the graph file; a restarted component continues from it."""
        self._close()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `save` with the written files and the map's quality, `status` with figures."""
        if verb not in ("save", "status") or arguments:
            return super().on_request(verb, arguments)
        mapper = self._mapper
        if mapper is None or not mapper.keyframes:
            raise CairnError(
                f"{self.name}: has no map yet: no scan was received on {self.scan.topic} with "
                f"odometry on {self.odom.topic}"
            )
        if verb == "save":
            if not self._save(mapper):
                raise CairnError(
                    f"{self.name}: has no map yet: scans on {self.scan.topic} show nothing; check "
                    "that nothing covers the scanner"
                )
            if self._saved.has_failed or self._saved_maps.has_failed:
                raise CairnError(f"{self.name}: the map is not saved; `cairn ps` has the reason")
            self._warn_unless_extended(mapper)
            file = self.config.map_file.absolute()
            written = [".yaml", ".pgm", ".graph", *([".cairn"] if self._has_landmarks else [])]
            return {
                "files": [str(file.with_suffix(end)) for end in written],
                "keyframes": len(mapper.keyframes),
                "quality": asdict(quality_of(mapper, self._drawing)),
            }
        return {
            "keyframes": len(mapper.keyframes),
            "submaps": len(mapper.submaps),
            "loops": mapper.closer.counts.accepted,
            "located": mapper.is_located,
        }

    @on("odom")
    def on_odometry(self, odom: Odometry) -> None:
        """Add odometry; map the scans that waited for it."""
        stamp = to_ns(odom.header.stamp)
        change = self._history.add(stamp, planar_pose(odom.pose.pose))
        if change is OdometryChange.RESET:
            self.log.warning("time on %s was set back: restarted its history", self.odom.topic)
            self._waiting.clear()
            self._objects.clear()
        self._process()

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Keep a scan until odometry has reached its last beam."""
        self._waiting.add(scan)
        self._process()

    @on("objects")
    def on_objects(self, message: RecognizedObjectArray) -> None:
        """Keep recognized objects until odometry has reached their time."""
        self._objects.append(message)
        self._process()

    @every(hz=1)
    def publish_map(self) -> None:
        """Draw and publish what has changed; save the graph."""
        self._process()
        mapper = self._mapper
        if mapper is None or not mapper.keyframes:
            return
        self._draw(mapper, _DRAWN)
        now = self.clock.now()
        changes = self._drawing.counts.take_changes()
        frame = self._drawing.counts.frame
        if (frame, self._drawing.counts.shape) != self._published_frame:
            self._publish_full_map(now)
        elif changes is not None:
            row, column, cells = changes
            self.map_updates.publish(
                OccupancyGridUpdate(
                    header=Header(stamp=from_ns(now), frame_id="map"),
                    x=column,
                    y=row,
                    width=cells.shape[1],
                    height=cells.shape[0],
                    data=cells.ravel(),
                )
            )
            self._full_map_is_outdated = True
        if self._full_map_is_outdated and has_passed(_SAVE_S, self._full_map_at, now):
            self._publish_full_map(now)
        if has_passed(_SAVE_S, self._saved_at, now):
            self._save_graph()

    def _process(self) -> None:
        """Map the scans whose odometry has arrived, or will not arrive any more."""
        newest, now = self._history.newest, self.clock.now()
        for scan in self._waiting.release(newest, now):
            self._map_scan(scan)
        while self._objects:
            stamp = to_ns(self._objects[0].header.stamp)
            is_early = newest is None or stamp > newest
            if is_early and abs(now - stamp) < ODOMETRY_DISORDER_S * SECOND:
                return
            self._map_objects(stamp, self._objects.popleft())

    def _map_scan(self, scan: LaserScan) -> None:
        sweep = sweep_of(scan, self._odometry_at)
        if sweep is None:
            self._warnings.warn(
                "odometry", f"scan on {self.scan.topic} ignored: it is older than all odometry"
            )
            return
        stamp = to_ns(scan.header.stamp)
        if self._mapper is None:
            self._mapper = self._start(scan)
            self._drawing.counts.renew(self._mapper.renewals)
        mapper = self._mapper
        motion = sweep.motion
        rays = rays_of(scan, self.config.mount.pose, motion).placed(motion)
        before = mapper.closer.counts.accepted
        tracked = mapper.add_scan(stamp, sweep.start, rays)
        if mapper.closer.counts.accepted > before:
            self.log.info("closed a loop (%d in all)", mapper.closer.counts.accepted)
        if tracked.is_lost:
            self.log.warning(
                "the robot was moved: scans on %s fit nowhere near; searching the map for it",
                self.scan.topic,
            )
        located = mapper.is_located
        if located and not self._was_located:
            self.log.info("found the robot in the map at (%.2f m, %.2f m, %.2f rad)", *mapper.pose)
        self._was_located = located
        header = Header(stamp=scan.header.stamp, frame_id="map")
        self._publish_pose(header, mapper, sweep.start, tracked)

    def _map_objects(self, stamp: int, message: RecognizedObjectArray) -> None:
        odometry = self._odometry_at(stamp)
        if self._mapper is not None and odometry is not None:
            self._mapper.add_observations(stamp, odometry, observations_of(message))

    def _odometry_at(self, stamp: int) -> Pose | None:
        """Return the pose in a frame of odometry that has no jumps; None before the oldest."""
        return None if self._history.at(stamp) is None else self._history.driven_at(stamp)

    def _start(self, scan: LaserScan) -> Mapper:
        """Return the mapper of a new map, or of the one that an earlier process or run has left."""
        config = self.config
        path = self._graph_file
        if self.restarts > 0 and path.exists():
            self._file, mapper = GraphFile.open(path)
            if mapper.keyframes:
                mapper.resume(here=True)
                self.log.warning("continued the map of %d scans", len(mapper.keyframes))
                return mapper
            self._file.close()  # the earlier process had not saved anything yet
            path.unlink(missing_ok=True)
            remove_side_files(path)
        farthest = min(config.reach, float(scan.range_max))
        if config.extend is not None:
            mapper = read_graph(config.extend)
            mapper.resume(here=False)
            self.log.info("extending the map of %d scans: searching it", len(mapper.keyframes))
        else:
            mapper = Mapper(farthest)
        created_s = self.clock.now() / SECOND
        self._file = GraphFile.create(path, mapper.farthest, f"mapped by {self.name}", created_s)
        return mapper

    def _draw(self, mapper: Mapper, most: int | None) -> None:
        try:
            self._drawing.update(mapper.keyframes, mapper.graph.poses, mapper.in_map(), most)
        except ValueError as error:
            self._warnings.warn("size", f"map not drawn further: {error}; raise `resolution`")

    def _publish_full_map(self, now: int) -> None:
        counts = self._drawing.counts
        self._full_map_at, self._full_map_is_outdated = now, False
        self._published_frame = counts.frame, counts.shape
        grid: OccupancyCells = counts.whole()
        stamp = from_ns(now)
        self.map.publish(map_message(Header(stamp=stamp, frame_id="map"), grid, stamp))

    def _publish_pose(
        self, header: Header, mapper: Mapper, odometry: Pose, tracked: Tracked
    ) -> None:
        located = mapper.is_located
        health, reason = _health(tracked, mapper.tracker.usual_fit, located=located)
        covariance = np.asarray(np.linalg.inv(tracked.information + np.eye(3)), np.float64)
        pose = with_covariance(mapper.pose, covariance) if located else None
        self.localization.publish(
            LocalizationEstimate(
                header=header,
                located=located,
                pose=pose or PoseWithCovariance(),
                health=health,
                position_sd=math.sqrt(covariance[0, 0] + covariance[1, 1]) if located else 0.0,
                heading_sd=math.sqrt(covariance[2, 2]) if located else 0.0,
                scan_fit=math.nan if tracked.fit is None else tracked.fit,
                reason=reason.text,
                reason_code=int(reason.code),
            )
        )
        if pose is not None:
            self.pose.publish(PoseWithCovarianceStamped(header=header, pose=pose))
            offset = compose(mapper.pose, inverse(odometry))
            self.tf.publish(TFMessage(transforms=(transform_message(header, "odom", offset),)))

    def _save_graph(self, *, now: bool = False) -> None:
        mapper, file = self._mapper, self._file
        if mapper is None or file is None:
            return
        lost = "what was mapped since the last save is lost"
        if self._saved.attempt(lambda: file.save(mapper), lambda: lost, now=now):
            self._saved_at = self.clock.now()

    @property
    def _graph_file(self) -> Path:
        return self.config.map_file.with_suffix(".graph")

    def _save(self, mapper: Mapper) -> bool:
        """Save the map with all scans; return whether they show anything.

        Without that, there is no grid map.
        """
        mapper.settle()
        self._save_graph(now=True)
        self._draw(mapper, None)
        if not any(self._drawing.counts.shape):
            return False
        grid, file = self._drawing.counts.grid(), self.config.map_file
        landmarks = mapper.landmarks().landmarks
        self._has_landmarks = bool(landmarks)
        created_s = self.clock.now() / SECOND

        def write() -> None:
            write_map(file, grid)
            if landmarks:
                write_landmarks(
                    file.with_suffix(".cairn"), f"mapped by {self.name}", landmarks, created_s
                )

        lost = "the grid map and the visual map are not written; the graph has all of them"
        self._saved_maps.attempt(write, lambda: lost, now=True)
        return True

    def _warn_unless_extended(self, mapper: Mapper) -> None:
        extended = mapper.graph.extended
        if extended and not mapper.in_map()[extended:].any():
            self.log.warning(
                "no place of the map that is extended was recognized, so it was saved as it was; "
                "drive where it was mapped"
            )

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _health(tracked: Tracked, usual_fit: float, *, located: bool) -> tuple[float, Reason]:
    """Return the health of the pose, full if the scan fits as usual, and what lowers it."""
    if not located:
        text = "no place of the map is recognized yet"
        return 0.0, Reason(ReasonCode.NOT_LOCATED, text)
    if tracked.fit is None:
        text = "the scan has too few points: the pose follows odometry"
        return _MOST_WITHOUT_POINTS, Reason(ReasonCode.SCAN_HITS_NOTHING, text)
    share = tracked.fit / usual_fit if tracked.fit < usual_fit else 1.0
    if tracked.is_misfit:
        text = f"the map explains {tracked.fit:.0%} of the scan"
        return share, Reason(ReasonCode.SCAN_MISMATCH, text)
    return 1.0, NO_REASON
