"""Objects that should be in view and are not: where one is expected, and what may hide it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.health import SILENT_S
from cairn.components.localizer.observations import CameraView, Landmark, Observation
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.planar.poses import Pose, relative, wrap

Array = NDArray[np.float64]

# An object whose middle lies nearer to the edge of the view than this [m] may be cut off by it.
_EDGE_M = 0.3
# Share of the ranges in view that is not counted on at either end.
_RANGE_MARGIN = 0.1
# Beams within this [rad] of an object's direction tell whether anything stands before it.
_ASIDE_RAD = 0.06
# A beam that ends no farther than this [m] before the object ends at it, or at what it hangs on.
_BEFORE_M = 0.3


# An object is missed only if another one was recognized no longer ago than this [s]: else it may be
# the light or the camera that fails. Should it fail, only a look or two fall into this time.
_PROVEN_S = 3.0
# It may be so long ago [s] if none but this one was missed since.
_PROVEN_BUT_FOR_ONE_S = 30.0


class AbsenceDetector:
    """Knows what the newest scan saw and which objects were seen in their places of late."""

    def __init__(self) -> None:
        self._points = self._misses = np.empty((0, 2))
        self._scanned_at = -math.inf
        self._at: Pose = (0.0, 0.0, 0.0)
        self._agreed_at: dict[int, float] = {}
        self._missed: set[int] = set()

    def scanned(self, stamp: float, points: Array, misses: Array, at: Pose) -> None:
        """Take a scan of `stamp` [s] from the dead-reckoned pose `at`: what its beams hit (n, 2)
        [m], and where those end that hit nothing (m, 2) [m], in the base's frame.
        """
        self._scanned_at = stamp
        self._points, self._misses, self._at = points, misses, at

    def agreed(self, stamp: float, objects: Iterable[int]) -> None:
        """Take which objects were seen in their places at `stamp` [s]."""
        seen = dict.fromkeys(objects, stamp)
        self._agreed_at |= seen
        if seen:
            self._missed.clear()

    def missed(
        self,
        stamp: float,
        view: CameraView,
        seen: Iterable[Observation],
        landmarks: Mapping[int, Landmark],
        pose: PoseEstimate,
        now: Pose,
    ) -> list[tuple[Landmark, float, float]]:
        """What should be in view of `pose` and was not `seen`; its range [m] and bearing [rad].

        `now` is the dead-reckoned pose.
        """
        if stamp - self._scanned_at > SILENT_S:
            return []  # who stands before it now, no scan tells
        step = relative(now, self._at)
        points, misses = _carried(self._points, step), _carried(self._misses, step)
        named = {name for one in seen for name in (one.object_id, *one.alternatives)}
        found = []
        for landmark in landmarks.values():
            if not landmark.live or landmark.object_id in named:
                continue
            place = expected(pose, landmark, view)
            if place is not None and free_sight(points, misses, *place):
                found.append((landmark, *place))
        self._missed |= {landmark.object_id for landmark, _, _ in found}
        return [one for one in found if self._proven(stamp, one[0].object_id)]

    def _proven(self, stamp: float, object_id: int) -> bool:
        """Whether the camera recognizes others: it is this object that is missing."""
        ages = [stamp - then for other, then in self._agreed_at.items() if other != object_id]
        alone = self._missed <= {object_id}
        within_s = _PROVEN_BUT_FOR_ONE_S if alone else _PROVEN_S
        return any(age <= within_s for age in ages)


def expected(
    pose: PoseEstimate, landmark: Landmark, view: CameraView
) -> tuple[float, float] | None:
    """Range [m] and bearing [rad] at which `landmark` is well in view from `pose`; None if not."""
    x, y, theta = pose.mean
    dx, dy = landmark.x - x, landmark.y - y
    range_m = math.hypot(dx, dy)
    margin = _RANGE_MARGIN * (view.farthest - view.nearest)
    if not view.nearest + margin <= range_m <= view.farthest - margin:
        return None
    bearing = wrap(math.atan2(dy, dx) - theta)
    place = 0.5 * (landmark.xx + landmark.yy) + 0.5 * pose.spread**2
    deviation = math.sqrt(float(pose.covariance[2, 2]) + place / range_m**2)
    edge = _EDGE_M / range_m + 2.0 * deviation
    if not view.right + edge <= bearing <= view.left - edge:
        return None
    return range_m, bearing


def free_sight(points: Array, misses: Array, range_m: float, bearing: float) -> bool:
    """Whether the newest scan saw as far as an object at `range_m` [m], `bearing` [rad].

    `points` (n, 2) is what its beams hit and `misses` (m, 2) where those end that hit nothing,
    both in the base's frame [m]. A direction without any beam is not free.
    """
    ends = np.concatenate((points, misses))
    if not len(ends):
        return False
    aside = np.angle(np.exp(1j * (np.arctan2(ends[:, 1], ends[:, 0]) - bearing)))
    along = np.hypot(ends[:, 0], ends[:, 1])[np.abs(aside) <= _ASIDE_RAD]
    return bool(along.size) and bool(along.min() >= range_m - _BEFORE_M)


def _carried(ends: Array, step: Pose) -> Array:
    """Points (n, 2) [m] in a frame, as seen from where that frame lies at `step`."""
    x, y, turn = step
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = ends @ np.array([[cosine, sine], [-sine, cosine]])
    there: Array = turned + np.array([x, y])
    return there
