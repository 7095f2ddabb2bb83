"""The component Localizer: the robot's pose, its health, and evidence for and against objects."""

from __future__ import annotations

import math
from bisect import insort
from typing import Generic, TypeVar

import numpy as np

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
from cairn.components.localizer.config import LocalizerConfig
from cairn.components.localizer.health import PoseHealth, ScannerMonitor
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.messages import (
    estimate_message,
    evidence_message,
    landmarks_of,
    observations_of,
    relocalization_message,
    transform_message,
    view_of,
)
from cairn.components.localizer.observations import as_observed_from, view_as_from
from cairn.components.localizer.odometry import MeasuredTrack
from cairn.components.localizer.start_pose import find_start_pose, operator_pose, save
from cairn.planar.grid import grid_of
from cairn.planar.messages import packed_poses, planar_pose, with_covariance
from cairn.planar.odometry import OdometryHistory
from cairn.planar.pose_tracker import sweep_of
from cairn.planar.poses import Pose, compose, inverse, relative
from cairn.planar.scans import rays_of, sweep_s
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import ObjectEvidenceArray, RecognizedObjectArray, VisualMap
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, Relocalization
from cairn.schemas.geometry_msgs import PoseArray, PoseWithCovariance, PoseWithCovarianceStamped
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

# The cloud is moved at least this often [s], behind odometry by as much as observations may be late.
STEP_S, BEHIND_S = 0.5, 0.5
# Sightings later than this behind the cloud are of no use [s].
LATE_S = 1.0
# A gap in odometry that is worth telling of [s].
GAP_S = 1.5
POSE_EVERY_S = 0.0999
# While scans come at least this often [s], each gives a pose; else odometry does.
SCANS_S = 0.5
# So many records of odometry in a row that are older than the newest: time was set back.
OLDER_IN_A_ROW = 5
# How far [m], [rad] the robot may have come while odometry jumped.
JUMP_M, JUMP_RAD = 0.15, 0.15
T = TypeVar("T")
SHOWN = 200  # poses of the cloud on topic `particles`


class PendingMessages(Generic[T]):
    """Items by stamp [s], held until odometry has reached them, but not for ever."""

    def __init__(self, longest_s: float) -> None:
        self.longest_s = longest_s
        self._items: list[tuple[float, int, T]] = []
        self._count = 0

    def add(self, stamp: float, item: T) -> None:
        """Hold an item; of equal stamps the earlier comes first."""
        self._count += 1
        insort(self._items, (stamp, self._count, item), key=lambda entry: entry[:2])

    def release(self, odometry: float, now: float) -> list[tuple[float, T]]:
        """The items that odometry has reached, and those held longer than the limit."""
        ready = []
        while self._items:
            stamp = self._items[0][0]
            if stamp > odometry and now - stamp <= self.longest_s:
                break
            ready.append((stamp, self._items.pop(0)[2]))
        return ready

    @property
    def oldest(self) -> float | None:
        """The stamp of the item next to be released."""
        return self._items[0][0] if self._items else None


class Localizer(Component):
    """Estimates the robot's pose in the map by Monte Carlo localization.

    Fuses odometry, a range scanner against the grid map, and recognized objects of the visual map;
    either sensor may be missing. Judges every sighted object against the pose that all else gives.
    """

    config: LocalizerConfig
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    scan: In[LaserScan] = In(qos=SENSOR, optional=True)
    map: In[OccupancyGrid] = In(qos=LATCHED, optional=True)
    map_updates: In[OccupancyGridUpdate] = In(qos=RELIABLE.with_depth(50), optional=True)
    objects: In[RecognizedObjectArray] = In(qos=RELIABLE.with_depth(200), optional=True)
    visual_map: In[VisualMap] = In(qos=LATCHED.with_depth(20), optional=True)
    initialpose: In[PoseWithCovarianceStamped] = In(optional=True)
    localization: Out[LocalizationEstimate]
    pose: Out[PoseWithCovarianceStamped]
    particles: Out[PoseArray]
    object_evidence: Out[ObjectEvidenceArray] = Out(qos=RELIABLE.with_depth(200))
    relocalized: Out[Relocalization]
    tf: Out[TFMessage]

    def on_configure(self) -> None:
        """Take memory; the robot is not located before the first odometry."""
        folder = self.config.resume_file.parent if self.config.resume_file else None
        if folder is not None and not folder.is_dir():
            raise CairnError(f"{folder}: no such folder to keep the last pose in (resume_file)")
        self._was_located = False
        self._warnings = RateLimitedLog(self.log)
        self._lay_out()

    def _lay_out(self) -> None:
        self._track = self.config.base.track()
        self._localization = Localization(self.config.settings(), self._track, self.random)
        self._held: PendingMessages[LaserScan | RecognizedObjectArray] = PendingMessages(
            self.config.hold_s
        )
        self._history = OdometryHistory(5 * SECOND)
        self._scanner = ScannerMonitor()
        self._published = self._scanned = -math.inf
        self._jumps = self._older = 0

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """The clouds are laid out once."""
        raise ParameterRejected("the localizer takes its parameters when it is configured")

    @on("map")
    def use_grid(self, message: OccupancyGrid) -> None:
        """Take a grid map."""
        if message.data.size == 0:
            self._warnings.warn("map", f"the map on {self.map.topic} is empty: ignored")
            return
        self._localization.use_grid(grid_of(message))

    @on("map_updates")
    def renew_grid(self, update: OccupancyGridUpdate) -> None:
        """Take what has changed in the grid map."""
        here = self._localization.map
        if here is None:
            return
        values = update.data.reshape(update.height, update.width)
        if not here.fits(update.y, update.x, values):
            self._warnings.warn("update", f"an update on {self.map_updates.topic} is off the map")
            return
        here.renew(update.y, update.x, values)

    @on("visual_map")
    def use_map(self, visual_map: VisualMap) -> None:
        """Take the visual map's new state."""
        self._localization.use_map(landmarks_of(visual_map))

    @on("initialpose")
    def begin_at(self, given: PoseWithCovarianceStamped) -> None:
        """Take an operator's word for where the robot is."""
        where = operator_pose(given.pose)
        self._localization.locate(where.mean, where.covariance)
        self.log.info("told to be at (%.2f m, %.2f m, %.2f rad)", *where.mean)

    @on("odom")
    def follow(self, odom: Odometry) -> None:
        """Take odometry; work off the scans and observations that waited for it."""
        stamp = _seconds(odom.header.stamp)
        pose = planar_pose(odom.pose.pose)
        latest = self._track.latest
        if latest == -math.inf:
            self._localization.advance(stamp)
            known = find_start_pose(self.config, odom, stamp, self.log)
            if known is not None:
                self._localization.locate(known.mean, known.covariance)
        elif stamp - latest > GAP_S:
            self._warnings.warn(
                "gap", f"no odometry on {self.odom.topic} for {stamp - latest:.1f} s"
            )
        twist = odom.twist.twist
        if not self._localization.command(stamp, pose, twist.linear.x, twist.angular.z):
            self._older += 1
            if self._older < OLDER_IN_A_ROW:
                self._warnings.warn(
                    self.odom.topic,
                    f"time on {self.odom.topic} runs backwards, from {latest:.3f} s to "
                    f"{stamp:.3f} s: ignored",
                )
                return
            self._set_back(stamp)
            self._localization.command(stamp, pose, twist.linear.x, twist.angular.z)
        self._older = 0
        self._note_jump()
        self._history.add(to_ns(odom.header.stamp), pose)
        self._work_off()
        without_scans = stamp - self._scanned > SCANS_S
        if without_scans and stamp - self._published >= POSE_EVERY_S:
            self._localization_at(stamp, pose)

    @on("scan")
    def look(self, scan: LaserScan) -> None:
        """Take a scan; it waits until odometry has reached its last beam."""
        ends = _seconds(scan.header.stamp) + sweep_s(scan)
        if self._in_time(ends, self.scan.topic):
            self._held.add(ends, scan)
            self._work_off()

    @on("objects")
    def see(self, message: RecognizedObjectArray) -> None:
        """Take recognized objects; they wait until odometry has reached their time."""
        stamp = _seconds(message.header.stamp)
        if self._in_time(stamp, self.objects.topic):
            self._held.add(stamp, message)
            self._work_off()

    @every(hz=2)
    def publish_particles(self) -> None:
        """Show the cloud; work off what waits for odometry that never came."""
        self._work_off()
        if self._localization.located:
            # A generator of its own: to be looked at must not change what follows.
            cloud = self._localization.filters.cloud.sample(SHOWN, np.random.default_rng(0))
            header = self._header(self._track.integrated_to)
            self.particles.publish(PoseArray(header=header, poses=packed_poses(cloud.T)))

    @every(hz=1)
    def keep_pose(self) -> None:
        """Write down where the robot is, for a localizer that comes after."""
        file, at = self.config.resume_file, self._track.integrated_to
        if file is None or not self._localization.located or at == -math.inf:
            return
        odom = self._history.at(round(at * SECOND))
        if odom is None or self._localization.health().value < 0.5:
            return
        estimate = self._localization.pose()
        try:
            save(file, at, estimate.mean, estimate.covariance, odom)
        except OSError as error:
            self._warnings.warn("resume", f"the pose cannot be kept in {file}: {error.strerror}")

    def _in_time(self, stamp: float, topic: str) -> bool:
        late_s = self._track.integrated_to - stamp
        ahead_s = stamp - self.clock.now() / SECOND
        if late_s > LATE_S:
            why = f"{late_s:.1f} s late"
        elif ahead_s > self.config.hold_s:
            why = f"{ahead_s:.1f} s ahead of the clock; set that of its driver"
        else:
            return True
        self._warnings.warn(topic, f"what {topic} tells of {stamp:.3f} s is ignored: it is {why}")
        return False

    def _set_back(self, stamp: float) -> None:
        """Go on from the last pose, on a time that was set back to `stamp` [s]."""
        last, by_s = self._localization, self._track.latest - stamp
        self.log.warning("time on %s was set back by %.3f s", self.odom.topic, by_s)
        self._lay_out()
        self._localization.go_on_from(last, stamp)
        self._localization.doubt(JUMP_M, JUMP_RAD)

    def _note_jump(self) -> None:
        track = self._track
        if isinstance(track, MeasuredTrack) and track.jumps > self._jumps:
            self._jumps = track.jumps
            self._history.clear()
            self._localization.doubt(JUMP_M, JUMP_RAD)
            self._warnings.warn(
                "jump", f"odometry on {self.odom.topic} jumped: that step is left out"
            )

    def _work_off(self) -> None:
        track = self._track
        now = self.clock.now() / SECOND
        for stamp, item in self._held.release(track.latest, now):
            if stamp > track.latest:
                self._warnings.warn(
                    "wait", f"what was seen at {stamp:.3f} s found no odometry of that time"
                )
            if isinstance(item, LaserScan):
                self._fuse_scan(stamp, item)
            else:
                self._fuse_objects(stamp, item)
        waiting = self._held.oldest
        while track.latest - track.integrated_to >= STEP_S + BEHIND_S:
            if waiting is not None and waiting <= track.integrated_to + STEP_S:
                break
            self._localization.advance(track.integrated_to + STEP_S)

    def _fuse_scan(self, ends: float, scan: LaserScan) -> None:
        sweep = sweep_of(scan, self._history.at)
        moved = sweep.motion if sweep is not None else (0.0, 0.0, 0.0)
        rays = rays_of(scan, self.config.mount.pose, moved)
        self._scanned = ends
        found = self._localization.scan(ends, rays.points(), rays.misses())
        if not self._scanner.note(ends, rays, self._localization.contradicted):
            self._warnings.warn("blind", f"a scan on {self.scan.topic} tells nothing")
        if found:
            self._tell_found(ends)
        header = Header(stamp=scan.header.stamp, frame_id="map")
        if not self._localization.located:
            self._publish_estimate(header, None)
        elif sweep is not None:  # else the pose of the odometry frame at that time is not known
            estimate = self._localization.pose()
            at_first_beam = compose(estimate.mean, inverse(moved))
            self._publish(header, at_first_beam, sweep.start, estimate.covariance)

    def _fuse_objects(self, stamp: float, seen: RecognizedObjectArray) -> None:
        was_located = self._localization.located
        step = self._since(stamp)
        if step is None:
            self._warnings.warn(
                "late", f"what was seen at {stamp:.3f} s is ignored: no odometry of that time"
            )
            return
        view = view_of(seen)
        frame = self._localization.sight(
            stamp,
            [as_observed_from(observation, step) for observation in observations_of(seen)],
            view_as_from(view, step) if view is not None else None,
        )
        if frame is None:
            if self._localization.located and not was_located:
                self._tell_found(stamp)
            return
        self._tell_ranges()
        header = self._header(stamp)
        if frame.evidence:
            self.object_evidence.publish(evidence_message(header, frame))
        if frame.relocalized:
            self._tell_found(stamp)

    def _tell_ranges(self) -> None:
        factor = self._localization.range_factor
        if factor is None:
            self._warnings.resolved("ranges", "objects are as far away as the map has them again")
            return
        self._warnings.warn(
            "ranges",
            f"all objects on {self.objects.topic} are seen {100 * factor:.0f} % as far away as the "
            "map has them, so none is judged: calibrate the camera anew with `cairn camera "
            "calibrate`, and look whether the objects' sizes were told right",
        )

    def _since(self, stamp: float) -> Pose | None:
        """How the robot has moved from `stamp` [s] to the time that the cloud has come to; None if
        odometry does not tell, as across a jump.

        Scans come sooner than what a recognizer has to compute: its observations are older than the
        cloud.
        """
        measured = isinstance(self._track, MeasuredTrack)
        if not measured or stamp >= self._track.integrated_to:
            return (0.0, 0.0, 0.0)
        then = self._history.at(round(stamp * SECOND))
        now = self._history.at(round(self._track.integrated_to * SECOND))
        return None if then is None or now is None else relative(then, now)

    def _tell_found(self, stamp: float) -> None:
        found = self._localization.pose()
        if not self._was_located:
            self.log.info("found the robot at (%.2f m, %.2f m, %.2f rad)", *found.mean)
            self._was_located = True
            return
        self.log.warning(
            "the robot was lost and found itself at (%.2f m, %.2f m, %.2f rad)", *found.mean
        )
        confirmed_until = self._localization.confirmed_until
        self.relocalized.publish(
            relocalization_message(self._header(stamp), found, confirmed_until)
        )

    def _localization_at(self, stamp: float, odom: Pose) -> None:
        if not self._localization.located:
            self._published = stamp
            self._publish_estimate(self._header(stamp), None)
            return
        estimate = self._localization.pose()
        now = self._localization.ahead(estimate.mean, stamp)
        self._publish(self._header(stamp), now, odom, estimate.covariance)

    def _publish(self, header: Header, pose: Pose, odom: Pose, covariance: np.ndarray) -> None:
        self._was_located = True
        self._published = _seconds(header.stamp)
        message = with_covariance(pose, covariance)
        self._publish_estimate(header, message)
        self.pose.publish(PoseWithCovarianceStamped(header=header, pose=message))
        self.tf.publish(transform_message(header, pose, odom))

    def _publish_estimate(self, header: Header, pose: PoseWithCovariance | None) -> None:
        health: PoseHealth = self._localization.health()
        if self._localization.map is not None:
            health = self._scanner.limited(health, self._track.latest, self.scan.topic)
        particles = self._localization.filters.cloud.count
        self.localization.publish(estimate_message(header, pose, health, particles))

    def _header(self, stamp: float) -> Header:
        return Header(stamp=from_ns(round(stamp * SECOND)), frame_id="map")


def _seconds(stamp: Time) -> float:
    return to_ns(stamp) / SECOND
