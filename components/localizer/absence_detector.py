"""Detects objects that should be in view and are not: where they are expected, what hides them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.observations import CameraView, Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.pose_health import SILENT_S
from cairn.planar.poses import Pose, relative, wrap
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

# Half the width of a large poster [m]. An object whose middle is nearer to the edge of the view may
# be cut off by it; beams that pass the middle within this distance show whether anything stands in
# front of it; one that ends no farther before it ends at it, or at what it hangs on, as a cupboard.
_HALF_M = 0.3
# Share of the range in view that is not relied on at either end: there recognition fails first
# (docs/benchmarks.md, share of the objects by distance).
_RANGE_MARGIN = 0.1
# An object is missed only if another one was recognized no longer ago than this [s], and no other
# was missed in an image since: otherwise the light or the camera may fail. A robot that drives 0.4
# m/s comes to another object within 12 m.
_WORKING_S = 30.0


class AbsenceDetector:
    """Keeps the newest scan, and which objects were recently observed in their positions."""

    def __init__(self) -> None:
        self._points = self._misses = np.empty((0, 2))
        self._scanned_at = -math.inf
        self._scanned_from: Pose = (0.0, 0.0, 0.0)
        self._agreed_at: dict[int, float] = {}
        self._missed: set[int] = set()

    def add_scan(self, stamp: float, points: Array, misses: Array, at: Pose) -> None:
        """Add a scan of `stamp` [s] from the dead-reckoned pose `at`.

        `points` (n, 2) [m] are the ends of beams that hit something, `misses` (m, 2) [m] those of
        beams that did not, in the frame of the base.
        """
        self._scanned_at = stamp
        self._points, self._misses, self._scanned_from = points, misses, at

    def add_agreeing(self, stamp: float, objects: Iterable[int]) -> None:
        """Add the objects that were observed in their positions at `stamp` [s]."""
        agreed = dict.fromkeys(objects, stamp)
        self._agreed_at |= agreed
        if agreed:
            self._missed.clear()

    def missing(
        self,
        stamp: float,
        view: CameraView,
        observed: Iterable[Observation],
        landmarks: Mapping[int, Landmark],
        pose: PoseEstimate,
        now: Pose,
    ) -> list[tuple[Landmark, float, float]]:
        """Return what should be in view and was not observed, with range [m] and bearing [rad].

        Args:
            stamp: The time of the image [s].
            view: Where objects could have been recognized.
            observed: What was recognized.
            landmarks: The objects of the map.
            pose: The pose of the robot.
            now: Its dead-reckoned pose.

        """
        if stamp - self._scanned_at > SILENT_S:
            return []  # no scan shows what stands in front of an object now
        step = relative(now, self._scanned_from)
        points, misses = _carried(self._points, step), _carried(self._misses, step)
        named = {name for one in observed for name in (one.object_id, *one.alternatives)}
        found = []
        for landmark in landmarks.values():
            if not landmark.live or landmark.object_id in named:
                continue
            position = expected(pose, landmark, view)
            if position is not None and is_visible(points, misses, *position):
                found.append((landmark, *position))
        works = [one for one in found if self._camera_works(stamp, one[0].object_id)]
        self._missed |= {landmark.object_id for landmark, _, _ in found}
        return works

    def _camera_works(self, stamp: float, object_id: int) -> bool:
        """Whether other objects are recognized, so that this one is missing."""
        ages = [stamp - then for other, then in self._agreed_at.items() if other != object_id]
        return self._missed <= {object_id} and any(age <= _WORKING_S for age in ages)


def expected(
    pose: PoseEstimate, landmark: Landmark, view: CameraView
) -> tuple[float, float] | None:
    """Return range [m] and bearing [rad] at which `landmark` is well in view; None if it is not."""
    x, y, theta = pose.mean
    dx, dy = landmark.x - x, landmark.y - y
    range_m = math.hypot(dx, dy)
    margin = _RANGE_MARGIN * (view.farthest - view.nearest)
    if not view.nearest + margin <= range_m <= view.farthest - margin:
        return None
    bearing = wrap(math.atan2(dy, dx) - theta)
    position_variance = 0.5 * (landmark.xx + landmark.yy) + 0.5 * pose.spread**2
    deviation = math.sqrt(float(pose.covariance[2, 2]) + position_variance / range_m**2)
    edge = _HALF_M / range_m + 2.0 * deviation
    if not view.right + edge <= bearing <= view.left - edge:
        return None
    return range_m, bearing


def is_visible(points: Array, misses: Array, range_m: float, bearing: float) -> bool:
    """Whether the newest scan reached as far as an object at `range_m` [m], `bearing` [rad].

    `points` (n, 2) and `misses` (m, 2) [m] are the ends of the beams in the frame of the base. In a
    direction without any beam nothing is visible.
    """
    ends = np.concatenate((points, misses))
    if not len(ends):
        return False
    beside = np.angle(np.exp(1j * (np.arctan2(ends[:, 1], ends[:, 0]) - bearing)))
    along = np.hypot(ends[:, 0], ends[:, 1])[np.abs(beside) <= _HALF_M / range_m]
    return bool(along.size) and bool(along.min() >= range_m - _HALF_M)


def _carried(ends: Array, step: Pose) -> Array:
    """Return points (n, 2) [m] of a frame in the frame from which that one lies at `step`."""
    x, y, turn = step
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = ends @ np.array([[cosine, sine], [-sine, cosine]])
    carried: Array = turned + np.array([x, y])
    return carried
