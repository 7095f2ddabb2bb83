"""Monte Carlo localization by odometry, scans and recognized objects; its verdict on these."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.absence_detector import AbsenceDetector, CameraView
from cairn.components.localizer.config import LocalizationSettings
from cairn.components.localizer.covariance_calibration import CovarianceCalibrator
from cairn.components.localizer.global_search import RecentMeasurements
from cairn.components.localizer.health import LOST, PoseHealth, assess_health, limit_unconfirmed
from cairn.components.localizer.landmark_evidence import (
    LandmarkEvaluator,
    LandmarkEvidence,
    Verdict,
)
from cairn.components.localizer.leave_one_out import LeaveOneOutFilters
from cairn.components.localizer.likelihood_field import ScanMap
from cairn.components.localizer.observations import Landmark, Observation, as_certain, associate
from cairn.components.localizer.odometry import OdometryTrack, move_pose
from cairn.components.localizer.particle_set import ParticleSet, PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport, RecentObservations
from cairn.components.localizer.relocalization import ConfirmationHistory, Relocalizer
from cairn.components.localizer.scans import BeamSelector, RecentScans, ScanFit
from cairn.components.localizer.wheel_slip import WheelSlipDetector
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import ReasonCode

Array = NDArray[np.float64]

# Where the robot may be anywhere, less of a scan counts: what no map holds (people, furniture that
# was moved) fits some place or other by chance.
_SEARCH_SHARE = 0.4
# The starts and ends of no rays.
NO_RAYS = (np.empty((0, 2)), np.empty((0, 2)))


@dataclass(frozen=True)
class EvidenceFrame:
    """What one set of observations gave: the pose before it was fused, health, evidence."""

    before: PoseEstimate
    healthy: bool
    code: ReasonCode
    reason: str
    evidence: tuple[LandmarkEvidence, ...]
    relocalized: bool


class Localization:
    """The robot's pose from odometry, scans of a grid map and observations of mapped objects.

    Times are seconds of one clock. Call `command` for each odometry record, and `scan` and `sight`
    in the order of their stamps; `located` tells whether there is a pose.
    """

    def __init__(
        self, settings: LocalizationSettings, track: OdometryTrack, random: np.random.Generator
    ) -> None:
        self.settings = settings
        self.track = track
        cloud = ParticleSet(settings.particles, settings.most_particles, settings.motion, random)
        self.filters = LeaveOneOutFilters(cloud, settings.judge_particles, settings.judges)
        self.judge = LandmarkEvaluator(settings.mode, settings.ring_samples, random)
        self.recovery = Relocalizer(settings.search_particles, random)
        self.slip = WheelSlipDetector(random)
        self.landmarks: dict[int, Landmark] = {}
        self.map: ScanMap | None = None
        self.located = False
        self._observations = RecentObservations()
        self._scans = RecentScans()
        self._fit = ScanFit()
        self._stated = CovarianceCalibrator()
        self._reckoned: Pose = (0.0, 0.0, 0.0)
        self._moved_s = 0.0
        self._beams = BeamSelector(settings.beams)
        self._absence = AbsenceDetector()
        self._agreements = ConfirmationHistory()

    def locate(self, pose: Sequence[float], covariance: Array) -> None:
        """Begin (again) from a known pose: x [m], y [m], theta [rad] and covariance (3, 3)."""
        self.filters.set_gaussian(pose, covariance)
        self._placed_anew()
        self._forget()
        self.slip.forget()
        self.located = True
        self.recovery.believe()

    def go_on_from(self, other: Localization, stamp: float) -> None:
        """Take the maps and the pose that another one had, at the time `stamp` [s] of this one."""
        self.landmarks, self.map = other.landmarks, other.map
        self.advance(stamp)
        if other.located:
            pose = other.pose()
            self.locate(pose.mean, pose.covariance)

    def use_map(self, landmarks: Iterable[Landmark]) -> None:
        """Take a new state of the visual map."""
        before = self.landmarks
        self.landmarks = {landmark.object_id: landmark for landmark in landmarks}
        for object_id, old in before.items():
            new = self.landmarks.get(object_id)
            if old.live and (new is None or not new.live):
                # All that it said was said of a place it had left.
                self.filters.replace_by_filter_without(object_id)
            elif old.live and new is not None and math.hypot(new.x - old.x, new.y - old.y) > 0.3:
                self.judge.forget(object_id)

    def use_grid(self, grid: OccupancyCells) -> None:
        """Take a new grid map."""
        if self.map is None or not self.map.take(grid):
            self.map = ScanMap(grid, self.settings.beam_sd_m, self.settings.stray)

    def command(self, stamp: float, pose: Pose, forward: float, turn: float) -> bool:
        """Take odometry (pose, velocities [m/s, rad/s]); False if older than the newest one."""
        return self.track.append(stamp, pose, forward, turn)

    def advance(self, stamp: float) -> None:
        """Move everything to the time `stamp` [s]."""
        step = self.track.advance(stamp)
        self._reckoned = move_pose(self._reckoned, step)
        self._moved_s += step.moving_s
        self._beams.moved(step)
        if self.located:
            self.filters.move(step)

    def doubt(self, deviation_m: float, deviation_rad: float) -> None:
        """Widen the cloud: odometry has lost the thread."""
        if self.located:
            self.filters.widen(deviation_m, deviation_rad)

    def pose(self) -> PoseEstimate:
        """The pose at the time last advanced to, with an honest covariance."""
        known = self.filters.estimate()
        if self.map is None:
            return known
        return PoseEstimate(known.mean, self._stated.of(known, self.map.field.frame.resolution))

    @property
    def contradicted(self) -> bool:
        """Whether the newest scan hit nothing, although the map has obstacles within its reach."""
        return self._fit.contradicted

    @property
    def range_factor(self) -> float | None:
        """The factor by which the ranges of all objects err; None if they do not, or who knows."""
        return self.judge.ranges.wrong

    @property
    def confirmed_until(self) -> float:
        """Until when [s] the robot was where it believed to be, before it was placed where it is
        believed to be now; -inf if that is not known.
        """
        return self._agreements.confirmed_until

    def ahead(self, pose: Pose, stamp: float) -> Pose:
        """Where a robot that is at `pose` now is expected at the later time `stamp` [s]."""
        return move_pose(pose, self.track.preview(stamp))

    def health(self) -> PoseHealth:
        """How far the pose can be relied on."""
        if not self.located:
            return LOST
        pose = self.filters.estimate()
        health = assess_health(pose, self._support(pose, None), self._fit.value)
        doubt = self.recovery.doubts(self.track.integrated_to)
        return limit_unconfirmed(health, *doubt) if doubt is not None else health

    def scan(self, stamp: float, points: Array, misses: tuple[Array, Array] = NO_RAYS) -> bool:
        """Fuse a scan of `stamp` [s], end points (m, 2) [m] in the base's frame; True if the robot
        was lost and has found itself.

        `misses` are the starts and ends (m, 2) [m] of rays that hit nothing.
        """
        self.advance(stamp)
        self._absence.scanned(stamp, points, misses[1], self._reckoned)
        if self.map is None:
            return False
        if not len(points):
            if self.located:
                here = self.filters.estimate().mean
                self._fit.note(stamp, self.map.field, here, points, 0, *misses)
            return False
        chosen = self._beams.chosen(points)
        self._scans.add(chosen, self._reckoned)
        if not self.located:
            return self._find(stamp)
        new = self._beams.take_share_of_new()
        share = self._share(len(chosen)) * new
        scan_map = self.map
        before = self.filters.estimate()
        self.filters.fuse_scan(lambda poses: share * scan_map.field.log_likelihood(poses, chosen))
        pose = self.filters.estimate()
        self._stated.corrected(before, pose, new)
        slipped = None
        # A robot that may be somewhere else altogether is looked for in all the map.
        if self.recovery.sure(stamp):
            slipped = self.slip.look(
                pose, chosen, scan_map.field, self._share(len(chosen)), self._reckoned
            )
        if slipped is not None:
            # What was seen before is tied to now by a motion that was not made.
            self._forget()
            self._settle(slipped)
            self.recovery.doubt(stamp, self._reckoned)
            self._scans.add(chosen, self._reckoned)
            pose = self.filters.estimate()
        self._stated.fitted(
            scan_map.field.deviation(pose.mean, chosen), scan_map.field.frame.resolution
        )
        self._fit.note(stamp, scan_map.field, pose.mean, chosen, len(points), *misses)
        if self._fit.value is not None and self.recovery.suspects(self._fit.value):
            # What was seen before speaks of another place, should the robot have been carried.
            self._scans.clear()
            self._observations.clear()
            self._scans.add(chosen, self._reckoned)
        if self.recovery.due(stamp, contradicted=False):
            return self._recover(stamp)
        return False

    def sight(
        self, stamp: float, seen: Sequence[Observation], view: CameraView | None = None
    ) -> EvidenceFrame | None:
        """LandmarkEvaluator and fuse the objects seen at `stamp` [s]; None while the robot is not located.

        `view` is where they could have been seen, if that is known: what should be in it and was
        not seen is judged as well.
        """
        self.advance(stamp)
        here = self.filters.estimate() if self.located else None
        observations = associate(seen, here, self.landmarks)
        live = [s for s in observations if self._is_live(s.object_id)]
        self._observations.add(observations, self._reckoned, self._moved_s)
        if not self.located:
            if live:
                self._find(stamp)
            return None
        for observation in live:
            self.filters.ensure_filter(observation.object_id)
        before = self.filters.estimate()
        healthy, code, reason = self._healthy(before, self._support(before, None))
        evidence = tuple(self._judge(observation, before, healthy) for observation in observations)
        contradicted = any(one.contradicts for one in evidence)
        agreed = [one.observation.object_id for one in evidence if one.verdict is Verdict.AGREES]
        self._absence.agreed(stamp, agreed)
        self._agreements.note(stamp, (one for one in agreed if self._is_live(one)))
        if healthy and view is not None and self.range_factor is None:
            missed = self._absence.missed(stamp, view, seen, self.landmarks, before, self._reckoned)
            evidence += tuple(self.judge.unseen(before, *one) for one in missed)
        if live:
            self.filters.fuse_objects(live, self._fused(), self.settings.independence)
        relocalized = False
        if self.recovery.due(stamp, contradicted=contradicted):
            relocalized = self._recover(stamp)
        return EvidenceFrame(before, healthy, code, reason, evidence, relocalized)

    def _fused(self) -> Mapping[int, Landmark]:
        """The objects as they are fused."""
        if self.settings.fusion == "reliability":
            return self.landmarks
        return {key: as_certain(landmark) for key, landmark in self.landmarks.items()}

    def _is_live(self, object_id: int) -> bool:
        landmark = self.landmarks.get(object_id)
        return landmark is not None and landmark.live

    def _evidence(self) -> RecentMeasurements:
        return RecentMeasurements(
            observations=self._observations,
            scans=self._scans,
            landmarks=self.landmarks,
            map=self.map,
            scan_share=_SEARCH_SHARE * self._share(self.settings.beams),
            now=self._reckoned,
            moved_s=self._moved_s,
        )

    def _support(self, pose: PoseEstimate, left_out: int | None) -> PoseSupport:
        return self._observations.support(
            pose, self._reckoned, self._moved_s, self.landmarks, left_out
        )

    def _scans_vouch(self) -> bool:
        return self._fit.vouches(self.track.integrated_to)

    def _vouched(self, support: PoseSupport) -> bool:
        """Whether scans or other objects speak for a pose."""
        if support.firm:
            return True
        if not self._scans_vouch():
            return False
        # Where several objects were moved, more may contradict than agree. So they do to a robot
        # that is lost where it looks alike; but that one is not found here by a search.
        few = support.contradicting <= max(1, support.agreeing)
        return few or self.recovery.found_here(self.track.integrated_to)

    def _healthy(self, pose: PoseEstimate, support: PoseSupport) -> tuple[bool, ReasonCode, str]:
        limit = self.settings.healthy_spread_m
        if pose.spread > limit:
            return (
                False,
                ReasonCode.POSITION_UNCERTAIN,
                f"the pose is uncertain by {pose.spread:.2f} m (limit {limit:.2f} m)",
            )
        if not self._vouched(support):
            return (
                False,
                ReasonCode.OBJECTS_CONTRADICT,
                f"of the places seen of late {support.agreeing} agree with the pose and "
                f"{support.contradicting} contradict it",
            )
        return True, ReasonCode.NONE, ""

    def _judge(
        self, observation: Observation, before: PoseEstimate, healthy: bool
    ) -> LandmarkEvidence:
        object_id = observation.object_id
        if not self._is_live(object_id):
            return self.judge.place(observation, before, healthy)
        letter = self.settings.mode == "letter"
        pose = before if letter else self.filters.estimate_without(object_id)
        evidence = self._evidence()
        support = self._support(pose, object_id)
        return self.judge.compare(
            observation,
            pose,
            before,
            self.landmarks,
            self._vouched(support),
            support.agreeing >= support.contradicting or self._scans_vouch(),
            pose.spread <= self.settings.healthy_spread_m,
            self._scans_vouch(),
            lambda poses: evidence.log_likelihood(poses, object_id),
        )

    def _share(self, beams: int) -> float:
        return self.settings.scan_share * 60.0 / max(beams, 20)

    def _find(self, stamp: float) -> bool:
        found = self.recovery.find(stamp, self._evidence())
        if found is None:
            return False
        self._settle(found)
        return True

    def _recover(self, stamp: float) -> bool:
        found = self.recovery.recover(stamp, self._evidence(), self.filters.estimate())
        if found is None:
            return False
        self._settle(found)
        return True

    def _settle(self, poses: Array) -> None:
        self.filters.set_particles(poses)
        self._placed_anew()
        self._fit.forget()
        self._stated = CovarianceCalibrator()
        self.located = True

    def _placed_anew(self) -> None:
        """Drop what was made of objects seen from where the robot may not have been."""
        self.judge.clear()
        self._agreements.placed_anew(self.landmarks)

    def _forget(self) -> None:
        self._observations.clear()
        self._scans.clear()
        self._fit.forget()
        self._stated = CovarianceCalibrator()
