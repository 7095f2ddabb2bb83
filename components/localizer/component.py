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
    In,
    Out,
    RateLimitedLog,
    RetriedSave,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.localizer.config import LocalizerConfig
from cairn.components.localizer.landmark_evidence import LandmarkEvaluator
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.messages import (
    estimate_message,
    evidence_message,
    landmarks_of,
    relocalization_message,
    transform_message,
    view_of,
)
from cairn.components.localizer.observations import as_observed_from, view_as_from
from cairn.components.localizer.odometry import MeasuredTrack
from cairn.components.localizer.pose_differences import slip_covariance
from cairn.components.localizer.pose_health import SURE_HEALTH, ScannerMonitor
from cairn.components.localizer.start_pose import find_start_pose, operator_pose, save_last_pose
from cairn.planar.grid import grid_of
from cairn.planar.messages import packed_poses, planar_pose, with_covariance
from cairn.planar.odometry import OUTDATED_IN_A_ROW, OdometryChange, OdometryHistory
from cairn.planar.pose_tracker import sweep_of
from cairn.planar.poses import Pose, compose, inverse, relative
from cairn.planar.scans import rays_of, sweep_s
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import ObjectEvidenceArray, RecognizedObjectArray, VisualMap
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, Relocalization
from cairn.schemas.geometry_msgs import PoseArray, PoseWithCovariance, PoseWithCovarianceStamped
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import LARGEST_ORIGIN, OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.visual_map.observations import observations_of

# The particles are moved at least this often [s], and stay behind odometry by as much as
# observations may be late [s]: 95 % arrive within 0.15 s (docs/benchmarks.md, `vision`). Those that
# are later than twice that are dropped. While scans arrive at least this often, each gives a pose;
# otherwise odometry does.
BEHIND_S = 0.5
# Poses by odometry alone are published at 10 Hz [s]; the margin is for the jitter of its stamps.
POSE_EVERY_S = 0.0999
# So many particles are published on topic `particles`: enough for a picture.
PUBLISHED_PARTICLES = 200
_FASTEST = 100.0
"""Odometry with a higher speed [m/s, rad/s] is not that of a robot, and is ignored."""

T = TypeVar("T")


class PendingMessages(Generic[T]):
    """Messages by stamp [s] that wait until odometry has reached them, but not forever."""

    def __init__(self, longest_s: float) -> None:
        self.longest_s = longest_s
        self._messages: list[tuple[float, int, T]] = []
        self._count = 0

    def add(self, stamp: float, message: T) -> None:
        """Add a message; of equal stamps the one added first comes first."""
        self._count += 1
        insort(self._messages, (stamp, self._count, message), key=lambda entry: entry[:2])

    def release(self, odometry: float, now: float) -> list[tuple[float, T]]:
        """Return the messages that odometry has reached, and those that waited too long."""
        ready = []
        while self._messages:
            stamp = self._messages[0][0]
            if stamp > odometry and now - stamp <= self.longest_s:
                break
            ready.append((stamp, self._messages.pop(0)[2]))
        return ready

    @property
    def oldest(self) -> float | None:
        """The stamp of the message to be released next."""
        return self._messages[0][0] if self._messages else None


class Localizer(Component):
    """Estimates the robot's pose in the map by Monte Carlo localization.

    Fuses odometry, a range scanner against the grid map, and recognized objects of the visual map;
    either sensor may be missing. Compares every recognized object with the pose by everything else,
    and publishes the evidence.
    """

    # The particles are allocated once.
    live_parameters = frozenset()
    published_frames = frozenset({"odom"})
    config: LocalizerConfig
    operator_inputs = frozenset({"initialpose"})
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000), exclusive=True)
    scan: In[LaserScan] = In(qos=SENSOR, optional=True, exclusive=True)
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
        """Allocate the particles; the robot is not located before the first odometry."""
        folder = self.config.resume_file.parent if self.config.resume_file else None
        if folder is not None and not folder.is_dir():
            raise CairnError(f"{folder}: no such folder to keep the last pose in (resume_file)")
        self._was_located = False
        self._warnings = RateLimitedLog(self.log)
        self._saved_pose = RetriedSave(self, "last pose")
        self._reset()

    def _reset(self) -> None:
        self._track = self.config.base.track()
        self._localization = Localization(
            self.config.settings(), self._track, self.random, self.evaluator()
        )
        self._pending: PendingMessages[LaserScan | RecognizedObjectArray] = PendingMessages(
            self.config.hold_s
        )
        self._history = OdometryHistory[int](
            round(self._longest_behind_s() * SECOND),
            self._track.limits,
            resets_after=OUTDATED_IN_A_ROW,
        )
        self._scanner = ScannerMonitor()
        self._published = self._scanned = -math.inf

    def _longest_behind_s(self) -> float:
        """Return how far behind odometry [s] a scan or an observation may be.

        The particles wait for messages, and then are behind by a step; observations are late.
        """
        return self.config.hold_s + 4.0 * BEHIND_S

    def evaluator(self) -> LandmarkEvaluator:
        """Return what compares observations of objects with the pose."""
        return LandmarkEvaluator(self.config.mode, self.config.ring_samples, self.random)

    @on("map")
    def on_map(self, message: OccupancyGrid) -> None:
        """Replace the grid map."""
        if message.data.size == 0:
            self._warnings.warn("map", f"empty map on {self.map.topic} ignored")
            return
        self._localization.set_grid(grid_of(message))

    @on("map_updates")
    def on_map_update(self, update: OccupancyGridUpdate) -> None:
        """Replace a window of the grid map."""
        scan_map = self._localization.map
        if scan_map is None:
            return
        values = update.data.reshape(update.height, update.width)
        if not scan_map.fits(update.y, update.x, values):
            self._warnings.warn(
                "update", f"map update on {self.map_updates.topic} ignored: it leaves the map"
            )
            return
        scan_map.renew(update.y, update.x, values)

    @on("visual_map")
    def on_visual_map(self, visual_map: VisualMap) -> None:
        """Replace the visual map."""
        self._localization.set_landmarks(landmarks_of(visual_map))

    @on("initialpose")
    def on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        """Start from the pose that an operator states."""
        pose = operator_pose(message.pose)
        spread = math.sqrt(pose.covariance[0, 0] + pose.covariance[1, 1])
        if not _is_possible(pose.mean) or spread > LARGEST_ORIGIN:
            self._warnings.warn(
                self.initialpose.topic,
                f"pose on {self.initialpose.topic} rejected: ({pose.mean[0]:g} m, "
                f"{pose.mean[1]:g} m) with a deviation of {spread:g} m; coordinates are at most "
                f"{LARGEST_ORIGIN:g} m",
            )
            return
        self._localization.set_pose(pose.mean, pose.covariance)
        self.log.info("pose set by the operator: (%.2f m, %.2f m, %.2f rad)", *pose.mean)

    @on("odom")
    def on_odometry(self, odom: Odometry) -> None:
        """Add odometry; process the scans and observations that waited for it."""
        stamp = _seconds(odom.header.stamp)
        pose = planar_pose(odom.pose.pose)
        twist = odom.twist.twist
        speed, turn = twist.linear.x, twist.angular.z
        if not _is_possible(pose) or max(abs(speed), abs(turn)) > _FASTEST:
            self._warnings.warn(
                "impossible",
                f"odometry on {self.odom.topic} ignored: at ({pose[0]:g} m, {pose[1]:g} m) with "
                f"{speed:g} m/s and {turn:g} rad/s; at most {LARGEST_ORIGIN:g} m and {_FASTEST:g}",
            )
            return
        latest = self._track.latest
        if latest == -math.inf:
            self._localization.advance(stamp)
            known = find_start_pose(self.config, odom, stamp, self.log)
            if known is not None:
                self._localization.set_pose(known.mean, known.covariance)
        elif stamp - latest > self.config.hold_s + BEHIND_S:
            self._warnings.warn(
                "gap", f"no odometry on {self.odom.topic} for {stamp - latest:.1f} s"
            )
        change = self._localization.add_odometry(stamp, pose, speed, turn)
        if change is OdometryChange.OUTDATED:
            self._warnings.warn(
                self.odom.topic,
                f"odometry on {self.odom.topic} ignored: time runs backwards, from "
                f"{latest:.3f} s to {stamp:.3f} s",
            )
        elif change is OdometryChange.RESET:
            self._restart_at(stamp, latest)
            self._localization.add_odometry(stamp, pose, speed, turn)
        elif change is OdometryChange.JUMPED:
            self._localization.widen(slip_covariance())
            self._warnings.warn(
                "jump", f"odometry on {self.odom.topic} jumped: that step is ignored"
            )
        self._history.add(to_ns(odom.header.stamp), pose)
        if change in (OdometryChange.LATE, OdometryChange.OUTDATED):
            return
        self._process_pending()
        without_scans = stamp - self._scanned > BEHIND_S
        if without_scans and stamp - self._published >= POSE_EVERY_S:
            self._publish_by_odometry(stamp, pose)

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Keep a scan until odometry has reached its last beam."""
        end = _seconds(scan.header.stamp) + sweep_s(scan)
        if self._is_in_time(end, self.scan.topic):
            self._pending.add(end, scan)
            self._process_pending()

    @on("objects")
    def on_objects(self, message: RecognizedObjectArray) -> None:
        """Keep recognized objects until odometry has reached their time."""
        stamp = _seconds(message.header.stamp)
        if self._is_in_time(stamp, self.objects.topic):
            self._pending.add(stamp, message)
            self._process_pending()

    @every(hz=2)
    def publish_particles(self) -> None:
        """Publish particles; process messages whose odometry did not arrive in time."""
        self._process_pending()
        if self._localization.located:
            # With its own generator, so that publishing does not change what follows.
            random = np.random.default_rng(0)
            poses = self._localization.filters.particles.sample(PUBLISHED_PARTICLES, random)
            header = self._header(self._track.integrated_to)
            self.particles.publish(PoseArray(header=header, poses=packed_poses(poses.T)))

    @every(hz=1)
    def save_pose(self) -> None:
        """Save where the robot is, for a localizer that is started later."""
        file, at = self.config.resume_file, self._track.integrated_to
        if file is None or not self._localization.located or at == -math.inf:
            return
        odom = self._history.at(round(at * SECOND))
        if odom is None or self._localization.health().value < SURE_HEALTH:
            return
        estimate = self._localization.pose()
        self._saved_pose.attempt(
            lambda: save_last_pose(file, at, estimate.mean, estimate.covariance, odom),
            lambda: "the next localizer continues from an older pose, or searches the map",
        )

    def _is_in_time(self, stamp: float, topic: str) -> bool:
        late_s = self._track.integrated_to - stamp
        ahead_s = stamp - self.clock.now() / SECOND
        if late_s > 2.0 * BEHIND_S:
            why = f"{late_s:.1f} s late"
        elif ahead_s > self.config.hold_s:
            why = f"{ahead_s:.1f} s ahead of the clock; set the clock of its driver"
        else:
            return True
        self._warnings.warn(topic, f"message on {topic} of {stamp:.3f} s ignored: it is {why}")
        return False

    def _restart_at(self, stamp: float, latest: float) -> None:
        """Continue from the last pose, with time set back from `latest` to `stamp` [s]."""
        last = self._localization
        self.log.warning("time on %s was set back by %.3f s", self.odom.topic, latest - stamp)
        self._reset()
        self._localization.continue_from(last, stamp)
        self._localization.widen(slip_covariance())

    def _process_pending(self) -> None:
        """Fuse the messages that odometry has reached, in the order of their stamps."""
        track = self._track
        now = self.clock.now() / SECOND
        for stamp, message in self._pending.release(track.latest, now):
            if stamp > track.latest:
                self._warnings.warn(
                    "wait", f"no odometry for the scan or the objects of {stamp:.3f} s"
                )
            if isinstance(message, LaserScan):
                self._fuse_scan(stamp, message)
            else:
                self._fuse_objects(stamp, message)
        oldest = self._pending.oldest
        while (behind_s := track.latest - track.integrated_to) >= 2.0 * BEHIND_S:
            # A longer gap takes a single step, also if a stamp is decades in the future.
            is_gap = behind_s > self._longest_behind_s()
            step_s = behind_s - BEHIND_S if is_gap else BEHIND_S
            if oldest is not None and oldest <= track.integrated_to + step_s:
                break
            self._localization.advance(track.integrated_to + step_s)

    def _fuse_scan(self, end: float, scan: LaserScan) -> None:
        sweep = sweep_of(scan, self._history.at)
        moved = sweep.motion if sweep is not None else (0.0, 0.0, 0.0)
        rays = rays_of(scan, self.config.mount.pose, moved)
        self._scanned = end
        found = self._localization.fuse_scan(end, rays.points(), rays.misses())
        if not self._scanner.add(end, rays, self._localization.contradicted):
            self._warnings.warn("scanner", f"invalid scan on {self.scan.topic}")
        if found:
            self._announce_found(end)
        header = Header(stamp=scan.header.stamp, frame_id="map")
        if not self._localization.located:
            self._publish_estimate(header, None)
        elif sweep is not None:  # else the pose of the odometry frame at that time is not known
            estimate = self._localization.pose()
            at_first_beam = compose(estimate.mean, inverse(moved))
            self._publish(header, at_first_beam, sweep.start, estimate.covariance)

    def _fuse_objects(self, stamp: float, message: RecognizedObjectArray) -> None:
        was_located = self._localization.located
        step = self._motion_since(stamp)
        if step is None:
            self._warnings.warn(
                "late", f"objects of {stamp:.3f} s ignored: no odometry of that time"
            )
            return
        view = view_of(message)
        frame = self._localization.fuse_objects(
            stamp,
            [as_observed_from(observation, step) for observation in observations_of(message)],
            view_as_from(view, step) if view is not None else None,
        )
        if frame is None:
            if self._localization.located and not was_located:
                self._announce_found(stamp)
            return
        self._warn_of_wrong_ranges()
        if frame.evidence:
            self.object_evidence.publish(evidence_message(self._header(stamp), frame))
        if frame.relocalized:
            self._announce_found(stamp)

    def _warn_of_wrong_ranges(self) -> None:
        factor = self._localization.range_factor
        if factor is None:
            self._warnings.resolved("ranges", "ranges of objects agree with the map again")
            return
        self._warnings.warn(
            "ranges",
            f"ranges of all objects on {self.objects.topic} are {100 * factor:.0f} % of those in "
            "the map, so none gives evidence: recalibrate the camera with `cairn camera "
            "calibrate`, and check the sizes given for the objects",
        )

    def _motion_since(self, stamp: float) -> Pose | None:
        """Return the motion from `stamp` [s] to the time of the particles.

        None if odometry does not determine it, as across a jump. A recognizer takes longer than a
        scan: its observations are older than the particles.
        """
        measured = isinstance(self._track, MeasuredTrack)
        if not measured or stamp >= self._track.integrated_to:
            return (0.0, 0.0, 0.0)
        then = self._history.at(round(stamp * SECOND))
        now = self._history.at(round(self._track.integrated_to * SECOND))
        return None if then is None or now is None else relative(then, now)

    def _announce_found(self, stamp: float) -> None:
        """Log where the robot was found, and publish it if the robot had another pose before."""
        found = self._localization.pose()
        if not self._was_located:
            self.log.info("found the robot at (%.2f m, %.2f m, %.2f rad)", *found.mean)
            self._was_located = True
            return
        self.log.warning(
            "relocalized: the robot was lost and is at (%.2f m, %.2f m, %.2f rad)", *found.mean
        )
        confirmed_until = self._localization.confirmed_until
        self.relocalized.publish(
            relocalization_message(self._header(stamp), found, confirmed_until)
        )

    def _publish_by_odometry(self, stamp: float, odom: Pose) -> None:
        if not self._localization.located:
            self._published = stamp
            self._publish_estimate(self._header(stamp), None)
            return
        estimate = self._localization.pose()
        now = self._localization.predict(estimate.mean, stamp)
        self._publish(self._header(stamp), now, odom, estimate.covariance)

    def _publish(self, header: Header, pose: Pose, odom: Pose, covariance: np.ndarray) -> None:
        self._was_located = True
        self._published = _seconds(header.stamp)
        message = with_covariance(pose, covariance)
        self._publish_estimate(header, message)
        self.pose.publish(PoseWithCovarianceStamped(header=header, pose=message))
        self.tf.publish(transform_message(header, pose, odom))

    def _publish_estimate(self, header: Header, pose: PoseWithCovariance | None) -> None:
        health = self._localization.health()
        if self._localization.map is not None:
            health = self._scanner.limit(health, self._track.latest, self.scan.topic)
        particles = self._localization.filters.particles.count
        others = self._localization.alternatives() if pose is not None else []
        self.localization.publish(estimate_message(header, pose, health, particles, others))

    def _header(self, stamp: float) -> Header:
        return Header(stamp=from_ns(round(stamp * SECOND)), frame_id="map")


def _is_possible(pose: Pose) -> bool:
    """Return whether a pose is within the coordinates that a map may have."""
    return max(abs(pose[0]), abs(pose[1])) <= LARGEST_ORIGIN


def _seconds(stamp: Time) -> float:
    return to_ns(stamp) / SECOND
