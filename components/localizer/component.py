"""The component Localizer: the robot's pose, and evidence for and against mapped objects."""

from __future__ import annotations

import math

import numpy as np

from cairn.bus.qos import LATCHED, RELIABLE
from cairn.clock import SECOND, from_ns, to_ns
from cairn.component.component import Component
from cairn.component.handlers import every, on
from cairn.component.parameters import Config, ParameterRefused
from cairn.component.ports import In, Out
from components.localizer.config import LocalizerConfig
from components.localizer.localization import Localization
from components.localizer.messages import (
    cloud_message,
    evidence_message,
    landmarks_of,
    planar,
    pose_message,
    sightings_of,
    transform_message,
)
from components.localizer.object_likelihood import Sighting
from components.localizer.order import Held
from components.localizer.recent import compose
from schemas.builtin_interfaces import Time
from schemas.cairn_msgs import ObjectEvidenceArray, RecognizedObjectArray, VisualMap
from schemas.geometry_msgs import PoseArray, PoseWithCovarianceStamped
from schemas.nav_msgs import Odometry
from schemas.std_msgs import Header
from schemas.tf2_msgs import TFMessage

# The cloud is moved at least this often [s], behind odometry by as much as sightings may be late.
STEP_S, BEHIND_S = 0.5, 0.5
# Sightings later than this behind the cloud are of no use [s].
LATE_S = 1.0
# Over a gap in odometry longer than this [s] its own pose tells how the robot moved.
GAP_S = 1.5
POSE_EVERY_S = 0.0999
# A start is known as long as odometry has drifted less than this from its origin [m].
START_HOLDS_M = 0.5
SHOWN = 200  # poses of the cloud on topic `particles`


class Localizer(Component):
    """Estimates the robot's pose in the map by Monte Carlo localization.

    Judges every sighted object of the map against the pose that the other objects give.
    """

    config: LocalizerConfig
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    objects: In[RecognizedObjectArray] = In(qos=RELIABLE.with_depth(200))
    visual_map: In[VisualMap] = In(qos=LATCHED.with_depth(20))
    initialpose: In[PoseWithCovarianceStamped] = In(optional=True)
    pose: Out[PoseWithCovarianceStamped]
    particles: Out[PoseArray]
    object_evidence: Out[ObjectEvidenceArray] = Out(qos=RELIABLE.with_depth(200))
    relocalised: Out[PoseWithCovarianceStamped]
    tf: Out[TFMessage]

    def on_configure(self) -> None:
        """Take memory; the robot is not located before the first odometry."""
        self._localization = Localization(self.config.settings(), self.random)
        self._held: Held[list[Sighting]] = Held(self.config.hold_s)
        self._published = -math.inf
        self._told: dict[str, int] = {}
        self._last_odom = Odometry()

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """The clouds are laid out once."""
        raise ParameterRefused("the localizer takes its parameters when it is configured")

    @on("visual_map")
    def use_map(self, visual_map: VisualMap) -> None:
        """Take the map's new state."""
        self._localization.use_map(landmarks_of(visual_map))

    @on("initialpose")
    def begin_at(self, given: PoseWithCovarianceStamped) -> None:
        """Take an operator's word for where the robot is."""
        where, covariance = planar(given.pose)
        self._localization.locate(where, covariance)
        self.log.info("told to be at (%.2f m, %.2f m, %.2f rad)", *where)

    @on("odom")
    def follow(self, odom: Odometry) -> None:
        """Take a commanded velocity; work off the sightings that waited for it."""
        stamp = _seconds(odom.header.stamp)
        latest = self._localization.track.latest
        if latest == -math.inf:
            self._begin(odom, stamp)
        elif stamp - latest > GAP_S:
            self._localization.bridge(stamp, planar(self._last_odom.pose)[0], planar(odom.pose)[0])
            self._complain("gap", f"no odometry on {self.odom.topic} for {stamp - latest:.1f} s")
        twist = odom.twist.twist
        if not self._localization.command(stamp, twist.linear.x, twist.angular.z):
            self._complain_of_time(self.odom.topic, stamp, latest)
            return
        self._last_odom = odom
        self._work_off()
        if stamp - self._published >= POSE_EVERY_S:
            self._publish_pose(odom, stamp)

    @on("objects")
    def see(self, message: RecognizedObjectArray) -> None:
        """Take recognised objects; they wait until odometry has reached their time."""
        stamp = _seconds(message.header.stamp)
        reached = self._localization.track.integrated_to
        if stamp < reached - LATE_S:
            late_s = reached - stamp
            self._complain("late", f"sightings of {stamp:.3f} s are {late_s:.1f} s late: ignored")
            return
        if not self._held.add(stamp, sightings_of(message)):
            self._complain_of_time(self.objects.topic, stamp, reached)
            return
        self._work_off()

    @every(hz=2)
    def publish_particles(self) -> None:
        """Show the cloud; work off sightings whose odometry never came."""
        self._work_off()
        if self._localization.located:
            cloud = self._localization.bank.sample(SHOWN)
            stamp = from_ns(round(self._localization.track.integrated_to * SECOND))
            self.particles.publish(cloud_message(Header(stamp=stamp, frame_id="map"), cloud))

    def _begin(self, odom: Odometry, stamp: float) -> None:
        self._last_odom = odom
        self._localization.advance(stamp)
        start = self.config.start
        if start is None:
            self.log.info("start unknown: looking for the robot by the objects it sees")
            return
        moved, covariance = planar(odom.pose)
        drift = math.sqrt(covariance[0, 0] + covariance[1, 1])
        if drift > START_HOLDS_M:
            self.log.warning(
                "the known start no longer holds, as odometry has drifted by some %.1f m since: "
                "looking for the robot by the objects it sees",
                drift,
            )
            return
        spread = np.diag([start.position_sd**2, start.position_sd**2, start.heading_sd**2])
        self._localization.locate(
            compose((start.x, start.y, start.theta), moved), spread + covariance
        )

    def _work_off(self) -> None:
        track = self._localization.track
        now = self.clock.now() / SECOND
        for stamp, sightings in self._held.release(track.latest, now):
            if stamp > track.latest:
                self._complain("wait", f"sightings of {stamp:.3f} s found no odometry of that time")
            self._fuse(stamp, sightings)
        waiting = self._held.oldest
        while track.latest - track.integrated_to >= STEP_S + BEHIND_S:
            if waiting is not None and waiting <= track.integrated_to + STEP_S:
                break
            self._localization.advance(track.integrated_to + STEP_S)

    def _fuse(self, stamp: float, sightings: list[Sighting]) -> None:
        was_located = self._localization.located
        frame = self._localization.sight(stamp, sightings)
        header = Header(stamp=from_ns(round(stamp * SECOND)), frame_id="map")
        if frame is None:
            if self._localization.located and not was_located:
                self.log.info("found the robot by the objects that it sees")
            return
        self.object_evidence.publish(evidence_message(header, frame))
        if frame.relocalised:
            found = self._localization.pose()
            self.log.warning("the robot was lost and found itself again")
            self.relocalised.publish(pose_message(header, found.mean, found.covariance))

    def _publish_pose(self, odom: Odometry, stamp: float) -> None:
        if not self._localization.located:
            return
        self._published = stamp
        estimate = self._localization.pose()
        now = self._localization.ahead(estimate.mean, stamp)
        header = Header(stamp=odom.header.stamp, frame_id="map")
        self.pose.publish(pose_message(header, now, estimate.covariance))
        self.tf.publish(transform_message(header, now, planar(odom.pose)[0]))

    def _complain_of_time(self, topic: str, stamp: float, newest: float) -> None:
        self._complain(
            topic, f"time on {topic} runs backwards, from {newest:.3f} s to {stamp:.3f} s: ignored"
        )

    def _complain(self, about: str, what: str) -> None:
        count = self._told[about] = self._told.get(about, 0) + 1
        if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ...: told, never flooding the log
            self.log.warning("%s (%d times so far)", what, count)


def _seconds(stamp: Time) -> float:
    return to_ns(stamp) / SECOND
