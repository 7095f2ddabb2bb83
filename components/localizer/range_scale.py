"""Whether the ranges of all objects err by one factor, as those of a wrongly calibrated camera."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from statistics import median

from cairn.components.localizer.object_likelihood import Landmark, Sighting
from cairn.components.localizer.particles import Estimate
from cairn.planar.poses import wrap

# A sighting in the direction of its object [rad], and not by much more or less far, may tell of the
# ranges; another one is a false match, or its object was moved.
_ALONG_RAD = 0.1
_LEAST, _MOST = 0.4, 2.5
# Newest ratios of an object, and objects seen last, that are gone by.
_RATIOS, _OBJECTS = 5, 8
# So many objects tell whether ranges err, if the map has as many.
_ENOUGH = 3
# Ratios nearer to 1 are noise; of all objects together so much is a wrong calibration.
_NOISE, _WRONG = 0.04, 0.06
# Most objects share an error of the camera: theirs lie within this share of it.
_ALIKE = 0.5


class RangeScale:
    """Ratios of the ranges at which objects are seen to those at which the map has them.

    A moved object is seen at another range, but for the others the map is right. If they all seem
    to have come nearer by the same share, it is the camera.
    """

    def __init__(self) -> None:
        self._ratios: dict[int, deque[float]] = {}  # seen longest ago first

    def forget(self, object_id: int) -> None:
        """Drop what was noted of an object, as its place in the map changed."""
        self._ratios.pop(object_id, None)

    def clear(self) -> None:
        """Drop everything, as the robot was somewhere else."""
        self._ratios.clear()

    @property
    def wrong(self) -> float | None:
        """The factor by which ranges err, if it is clear that they do."""
        medians = [median(ratios) for ratios in self._ratios.values()]
        if len(medians) < _ENOUGH:
            return None
        factor = median(medians)
        error = abs(factor - 1.0)
        alike = sum(abs(one - factor) <= _ALIKE * error for one in medians)
        return factor if error > _WRONG and alike >= 0.75 * len(medians) else None

    def may_err(
        self, sighting: Sighting, pose: Estimate, landmarks: Mapping[int, Landmark]
    ) -> bool:
        """Note a sighting of a live object from a sure pose; whether it may be the ranges that err
        instead of its place in the map: the others err as well, or too few have been seen to tell.
        """
        landmark = landmarks[sighting.object_id]
        dx, dy = landmark.x - pose.mean[0], landmark.y - pose.mean[1]
        off_rad = wrap(sighting.bearing + pose.mean[2] - math.atan2(dy, dx))
        ratio = sighting.range_m / max(math.hypot(dx, dy), 0.05)
        if abs(off_rad) > _ALONG_RAD or not _LEAST < ratio < _MOST:
            return False
        known = self._ratios.pop(sighting.object_id, deque(maxlen=_RATIOS))
        others = [median(ratios) for ratios in self._ratios.values()]
        known.append(ratio)
        self._ratios[sighting.object_id] = known
        while len(self._ratios) > _OBJECTS:
            self._ratios.pop(next(iter(self._ratios)))
        if abs(ratio - 1.0) <= _NOISE:
            return False
        live = sum(one.live for one in landmarks.values()) - 1
        if len(others) < min(_ENOUGH, live):
            return True
        if not others:
            return False
        shared = median(others) - 1.0
        own = ratio - 1.0
        return abs(shared) > _NOISE and shared * own > 0.0 and abs(shared) >= _ALIKE * abs(own)
