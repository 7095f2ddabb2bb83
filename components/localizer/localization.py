"""Monte Carlo localization by odometry, scans and recognized objects, and evidence for objects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.absence_detector import AbsenceDetector
from cairn.components.localizer.config import LocalizationSettings
from cairn.components.localizer.covariance_calibration import CovarianceCalibrator
from cairn.components.localizer.global_search import SEARCH_SHARE, RecentMeasurements
from cairn.components.localizer.hypotheses import (
    GOOD_FIT,
    MOST_DOUBT,
    Alternative,
    PoseHypotheses,
)
from cairn.components.localizer.landmark_evidence import LandmarkEvaluator
from cairn.components.localizer.leave_one_out import LeaveOneOutFilters
from cairn.components.localizer.likelihood_field import ScanMap
from cairn.components.localizer.observations import (
    CameraView,
    Landmark,
    as_certain,
    associate,
    object_log_likelihood,
)
from cairn.components.localizer.odometry import OdometryTrack
from cairn.components.localizer.particle_set import ParticleSet, PoseEstimate
from cairn.components.localizer.pose_differences import is_elsewhere
from cairn.components.localizer.pose_health import (
    LOST,
    PoseHealth,
    assess_health,
    contradiction,
    limit_unconfirmed,
)
from cairn.components.localizer.recent_observations import (
    ConfirmationHistory,
    PoseSupport,
    RecentObservations,
)
from cairn.components.localizer.scan_fit import BeamSelector, RecentScans, ScanFit
from cairn.planar.grid import OccupancyCells
from cairn.planar.motion_model import move_pose
from cairn.planar.odometry import OdometryChange
from cairn.planar.odometry_gains import AS_MAPPED, SHOWN_M, GainEstimator, shows_position
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.schemas.cairn_nav_msgs import NO_REASON, Reason, ReasonCode
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

# The parameter `scan_share` is of so many beams; of fewer beams than the second the share does not
# grow further, as it is about 1 there.
_SHARED_BEAMS, _LEAST_BEAMS = 60.0, 20
# A landmark whose position changes by more than this [m] was moved; improvements are smaller.
# Chosen by hand; `lab/constants.yaml` has the effect of half and double.
_MOVED_M = 0.3
# The starts and ends of no rays.
NO_RAYS = (np.empty((0, 2)), np.empty((0, 2)))


@dataclass(frozen=True)
class EvidenceFrame:
    """The result of one image: the pose before it was fused, and the evidence of its objects.

    `reason` is why that pose is not `healthy`; `relocalized`: the robot was found elsewhere.
    """

    before: PoseEstimate
    healthy: bool
    reason: Reason
    evidence: tuple[ObjectEvidence, ...]
    relocalized: bool


class Localization:
    """The robot's pose from odometry, scans of a grid map and observations of mapped objects.

    Times are seconds of one clock. Call `add_odometry` for each record of odometry, and `fuse_scan`
    and `fuse_objects` in the order of their stamps; `located` is true if there is a pose. The
    `evaluator` compares observations with the pose; None: by the settings.
    """

    def __init__(
        self,
        settings: LocalizationSettings,
        track: OdometryTrack,
        random: np.random.Generator,
        evaluator: LandmarkEvaluator | None = None,
    ) -> None:
        self.settings = settings
        self.track = track
        particles = ParticleSet(
            settings.particles, settings.most_particles, settings.motion, random
        )
        self.filters = LeaveOneOutFilters(
            particles, settings.leave_one_out_particles, settings.leave_one_out_filters
        )
        self.evaluator = evaluator or LandmarkEvaluator(
            settings.mode, settings.ring_samples, random
        )
        self.hypotheses = PoseHypotheses(settings.search_particles, settings.motion, random)
        self.landmarks: dict[int, Landmark] = {}
        self.map: ScanMap | None = None
        self.located = False
        self._observations = RecentObservations()
        self._scans = RecentScans()
        self._fit = ScanFit()
        self._calibrator = CovarianceCalibrator()
        self._gains = GainEstimator(settings.motion, AS_MAPPED)
        self._reckoned: Pose = (0.0, 0.0, 0.0)
        self._moved_s = 0.0
        self._beams = BeamSelector(settings.beams)
        self._absence = AbsenceDetector()
        self._confirmations = ConfirmationHistory()

    def set_pose(self, pose: Sequence[float], covariance: Array) -> None:
        """Start (again) from a known pose: x [m], y [m], theta [rad] and covariance (3, 3)."""
        self.filters.set_gaussian(pose, covariance)
        self._on_pose_replaced()
        self._forget_measurements()
        self.located = True
        self.hypotheses.clear()

    def continue_from(self, other: Localization, stamp: float) -> None:
        """Use the maps and the pose of another instance, at the time `stamp` [s] of this one."""
        self.landmarks, self.map = other.landmarks, other.map
        self.advance(stamp)
        if other.located:
            pose = other.pose()
            self.set_pose(pose.mean, pose.covariance)

    def set_landmarks(self, landmarks: Iterable[Landmark]) -> None:
        """Replace the visual map."""
        before = self.landmarks
        self.landmarks = {landmark.object_id: landmark for landmark in landmarks}
        for object_id, old in before.items():
            new = self.landmarks.get(object_id)
            if old.live and (new is None or not new.live):
                # All its observations were compared with a position that it had left.
                self.filters.replace_by_filter_without(object_id)
            elif (
                old.live and new is not None and math.hypot(new.x - old.x, new.y - old.y) > _MOVED_M
            ):
                self.evaluator.forget(object_id)

    def set_grid(self, grid: OccupancyCells) -> None:
        """Replace the grid map."""
        if self.map is None or not self.map.replace(grid):
            self.map = ScanMap(grid, self.settings.beam_sd_m, self.settings.stray)

    def add_odometry(self, stamp: float, pose: Pose, forward: float, turn: float) -> OdometryChange:
        """Add odometry: pose, and velocities [m/s, rad/s]."""
        return self.track.add(stamp, pose, forward, turn)

    def advance(self, stamp: float) -> None:
        """Move all particles to the time `stamp` [s]."""
        step = self._gains.move(self.track.advance(stamp))
        self._reckoned = move_pose(self._reckoned, step)
        self._moved_s += step.moving_s
        self._beams.add_motion(step)
        self._fit.add_motion(step)
        self.hypotheses.move(step)
        if self.located:
            self.filters.move(step)

    def widen(self, covariance: Array) -> None:
        """Add a covariance (3, 3) to that of the particles, as odometry was interrupted."""
        self._gains.interrupt()
        if self.located:
            self.filters.widen(covariance)

    def pose(self) -> PoseEstimate:
        """Return the pose at the time last advanced to, with a calibrated covariance."""
        estimate = self.filters.estimate()
        if self.map is None:
            return estimate
        resolution = self.map.field.frame.resolution
        return PoseEstimate(estimate.mean, self._calibrator.calibrated(estimate, resolution))

    @property
    def contradicted(self) -> bool:
        """Whether the newest scan hit nothing, although the map has obstacles within its reach."""
        return self._fit.contradicted

    @property
    def range_factor(self) -> float | None:
        """The factor by which the ranges of all objects err; None if none is known."""
        return self.evaluator.ranges.wrong

    @property
    def confirmed_until(self) -> float:
        """Until when [s] the robot was certainly not lost before it was found elsewhere.

        -inf if that is not known.
        """
        return self._confirmations.confirmed_until

    def predict(self, pose: Pose, stamp: float) -> Pose:
        """Return where a robot that is at `pose` now is expected at the later time `stamp` [s]."""
        return move_pose(pose, self._gains.corrected(self.track.preview(stamp)))

    def health(self) -> PoseHealth:
        """Return how far the pose can be relied on."""
        if not self.located:
            return LOST
        pose = self.filters.estimate()
        health = assess_health(pose, self._support(pose, None), self._fit.value)
        doubt = self._position_doubt()
        return limit_unconfirmed(health, doubt) if doubt is not None else health

    def alternatives(self) -> list[Alternative]:
        """Return the other positions at which the robot may be, the most probable first."""
        if not self.located:
            return []
        return self.hypotheses.alternatives(self._recent(), self.filters.estimate())

    def fuse_scan(self, stamp: float, points: Array, misses: tuple[Array, Array] = NO_RAYS) -> bool:
        """Fuse a scan of `stamp` [s]; return True if the robot was lost and has been found.

        `points` (m, 2) [m] are the end points in the frame of the base, `misses` the starts and
        ends (m, 2) [m] of rays that hit nothing.
        """
        self.advance(stamp)
        self._absence.add_scan(stamp, points, misses[1], self._reckoned)
        if self.map is None:
            return False
        if not len(points):
            if self.located:
                here = self.filters.estimate().mean
                self._fit.update(stamp, self.map.field, here, points, 0, *misses)
            return False
        selected = self._beams.select(points)
        self._scans.add(selected, self._reckoned)
        share = self._scan_share(len(selected))
        new = self._beams.take_share_of_new()
        field = self.map.field

        def likelihood(poses: Array) -> Array:
            return share * field.log_likelihood(poses, selected)

        current = self.filters.particles if self.located else None
        self.hypotheses.add_scan(
            likelihood, lambda pose: share * field.through_walls(pose, selected), current
        )
        self.hypotheses.fuse(lambda poses: new * likelihood(poses))
        if not self.located:
            return self._find(stamp)
        before = self.filters.estimate()
        self.filters.fuse_scan(lambda poses: new * likelihood(poses))
        pose = self.filters.estimate()
        is_shown = pose.widest < SHOWN_M and shows_position(likelihood, pose.mean)
        self._gains.add(pose.mean, shown=is_shown)
        self._calibrator.add_correction(before, pose, new)
        self._calibrator.add_deviation(field.deviation(pose.mean, selected), field.frame.resolution)
        was_lost = self._fit.lost
        self._fit.update(stamp, field, pose.mean, selected, len(points), *misses, new)
        if self._fit.lost and not was_lost:
            # If the robot was carried, the earlier measurements are of another position.
            self._scans.clear()
            self._observations.clear()
            self._scans.add(selected, self._reckoned)
        if field.fit(pose.mean, selected) < GOOD_FIT:
            self.hypotheses.search_near(
                pose, likelihood, lambda pose: self._fit.as_usual(field.fit(pose, selected))
            )
        return self._judge_hypotheses(stamp, pose, contradicted=False)

    def fuse_objects(
        self, stamp: float, observed: Sequence[Observation], view: CameraView | None = None
    ) -> EvidenceFrame | None:
        """Compare and fuse the objects observed at `stamp` [s]; None while there is no pose.

        `view` is where they could have been observed, if that is known: objects that should be in
        it and were not observed give evidence as well.
        """
        self.advance(stamp)
        here = self.filters.estimate() if self.located else None
        observations = associate(observed, here, self.landmarks)
        live = [one for one in observations if self._is_live(one.object_id)]
        self._observations.add(observations, self._reckoned, self._moved_s)
        if not self.located:
            if live:
                self.hypotheses.fuse(self._likelihood_of(live))
                self._find(stamp)
            return None
        for observation in live:
            self.filters.ensure_filter(observation.object_id)
        before = self.filters.estimate()
        doubt = self._doubt(before, self._support(before, None))
        healthy = doubt is None
        compared = [self._evidence_of(one, before, healthy) for one in observations]
        evidence = tuple(one for one, _ in compared)
        contradicted = any(contradicts for _, contradicts in compared)
        agreed = [one.object_id for one in evidence if one.verdict == ObjectEvidence.AGREES]
        self._absence.add_agreeing(stamp, agreed)
        self._confirmations.add(stamp, (one for one in agreed if self._is_live(one)))
        if healthy and view is not None and self.range_factor is None:
            missing = self._absence.missing(
                stamp, view, observed, self.landmarks, before, self._reckoned
            )
            evidence += tuple(self.evaluator.unseen(before, *one) for one in missing)
        if live:
            self.filters.fuse_objects(live, self._fused_landmarks(), self.settings.independence)
            self.hypotheses.fuse(self._likelihood_of(live))
        relocalized = self._judge_hypotheses(stamp, self.filters.estimate(), contradicted)
        return EvidenceFrame(before, healthy, doubt or NO_REASON, evidence, relocalized)

    def _judge_hypotheses(self, stamp: float, here: PoseEstimate, contradicted: bool) -> bool:
        """Search for hypotheses if that is due, and change to a better one.

        Return whether the robot was lost and has been found: a slip of the wheels does not count.
        """
        recent = self._recent()
        if self.hypotheses.search_due(stamp, self._fit, contradicted):
            self.hypotheses.search(stamp, recent, here, self._fit.lost_at_once)
        self.hypotheses.drop_near(recent, here)
        better = self.hypotheses.take_better(recent, here, self.filters.particles, self._fit)
        if better is None:
            return False
        self._replace_pose(better)
        if is_elsewhere(here.mean, self.filters.estimate().mean):
            self.hypotheses.on_found()
            return True
        # Odometry relates the earlier measurements to now by a motion that was not made.
        self._scans.clear()
        self._observations.clear()
        return False

    def _likelihood_of(self, live: Sequence[Observation]) -> Callable[[Array], Array]:
        """Return the log-likelihood of observations of live objects, as they are fused."""
        landmarks, share = self._fused_landmarks(), self.settings.independence

        def total(poses: Array) -> Array:
            each = [object_log_likelihood(poses, one, landmarks[one.object_id]) for one in live]
            result: Array = share * np.sum(each, axis=0)
            return result

        return total

    def _fused_landmarks(self) -> Mapping[int, Landmark]:
        """Return the objects as they are fused."""
        if self.settings.fusion == "reliability":
            return self.landmarks
        return {key: as_certain(landmark) for key, landmark in self.landmarks.items()}

    def _is_live(self, object_id: int) -> bool:
        landmark = self.landmarks.get(object_id)
        return landmark is not None and landmark.live

    def _recent(self) -> RecentMeasurements:
        return RecentMeasurements(
            observations=self._observations,
            scans=self._scans,
            landmarks=self.landmarks,
            map=self.map,
            scan_share=SEARCH_SHARE * self._scan_share(self.settings.beams),
            now=self._reckoned,
            moved_s=self._moved_s,
        )

    def _support(self, pose: PoseEstimate, left_out: int | None) -> PoseSupport:
        return self._observations.support(
            pose, self._reckoned, self._moved_s, self.landmarks, left_out
        )

    def _scans_support(self) -> bool:
        return self._fit.supports(self.track.integrated_to)

    def _is_supported(self, support: PoseSupport) -> bool:
        """Whether scans or other objects support a pose."""
        if support.firm:
            return True
        if not self._scans_support():
            return False
        # Where several objects were moved, more may contradict than agree. The same holds for a
        # robot that is lost where the map looks alike; but a search does not find that one here.
        few = support.contradicting <= max(1, support.agreeing)
        here = self.filters.estimate()
        return few or self.hypotheses.found_here(self.track.integrated_to, here)

    def _position_doubt(self) -> Reason | None:
        """Return why the robot may be at another position; None if nothing indicates that."""
        fit = self._fit
        if fit.lost:
            return Reason(
                ReasonCode.SCAN_MISMATCH,
                f"scans fit the map by {fit.value or 0.0:.0%}, usually by {fit.usual or 0.0:.0%}",
            )
        others = self.alternatives()
        if sum(one.probability for one in others) < MOST_DOUBT:
            return None
        x, y, _ = others[0].pose
        return Reason(
            ReasonCode.UNCONFIRMED,
            f"the robot may also be at ({x:.1f} m, {y:.1f} m), with a probability of "
            f"{others[0].probability:.0%}",
        )

    def _doubt(self, pose: PoseEstimate, support: PoseSupport) -> Reason | None:
        """Return why a pose is not healthy; None if it is."""
        limit = self.settings.healthy_spread_m
        if pose.spread > limit:
            return Reason(
                ReasonCode.POSITION_UNCERTAIN,
                f"the pose is uncertain by {pose.spread:.2f} m (limit {limit:.2f} m)",
            )
        if not self._is_supported(support):
            return Reason(ReasonCode.OBJECTS_CONTRADICT, contradiction(support))
        return None

    def _evidence_of(
        self, observation: Observation, before: PoseEstimate, healthy: bool
    ) -> tuple[ObjectEvidence, bool]:
        """Return the evidence of an observation, and whether it contradicts the pose."""
        object_id = observation.object_id
        if not self._is_live(object_id):
            return self.evaluator.locate(observation, before, healthy), False
        pose = self.filters.estimate_without(object_id)
        recent = self._recent()
        support = self._support(pose, object_id)
        return self.evaluator.compare(
            observation,
            pose,
            before,
            self.landmarks,
            self._is_supported(support),
            support.agreeing >= support.contradicting or self._scans_support(),
            pose.spread <= self.settings.healthy_spread_m,
            self._scans_support(),
            lambda poses: recent.log_likelihood(poses, object_id),
        )

    def _scan_share(self, beams: int) -> float:
        return self.settings.scan_share * _SHARED_BEAMS / max(beams, _LEAST_BEAMS)

    def _find(self, stamp: float) -> bool:
        found = self.hypotheses.find(stamp, self._recent())
        if found is None:
            return False
        self._replace_pose(found)
        self.hypotheses.on_found()
        return True

    def _replace_pose(self, poses: Array) -> None:
        """Replace the particles, as the robot was found elsewhere."""
        self.filters.set_particles(poses)
        self._on_pose_replaced()
        self._fit.reset()
        self._calibrator = CovarianceCalibrator()
        self.located = True

    def _on_pose_replaced(self) -> None:
        """Drop the conclusions about motion and objects from a wrong pose."""
        self._gains.interrupt()
        self.evaluator.clear()
        self._confirmations.on_pose_replaced(self.landmarks)

    def _forget_measurements(self) -> None:
        self._observations.clear()
        self._scans.clear()
        self._fit.reset()
        self._calibrator = CovarianceCalibrator()
