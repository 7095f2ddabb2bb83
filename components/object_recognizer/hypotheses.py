"""Hypotheses: things that were never taught, and the evidence that they are good landmarks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.planar.poses import Pose, apart, wrap
from cairn.schemas.cairn_msgs import RecognizedObject
from cairn.vision.object_model import ObjectModel

Array = NDArray[np.float64]

MOST_HYPOTHESES: Final = 40
"""Hypotheses that are kept; the one that was recognized least is forgotten first."""

MOST_PROPOSALS: Final = 100
"""Proposals, and rejected things, that are kept; with more, nothing new is proposed."""

# Recognized from a pose nearer than this to an earlier one [m], [rad], a thing shows nothing new.
_OTHER_M, _OTHER_RAD = 0.25, 0.25
_MOST_SIGHTINGS = 40
# A sighting agrees with the place by the others within so many standard deviations, or this [m]:
# errors of the pose that its covariance does not state.
_DEVIATIONS, _FLOOR_M = 3.0, 0.1
# Beyond so many standard deviations, and this [m], the thing is somewhere else: it moves, or there
# are several that look alike.
_ELSEWHERE_DEVIATIONS, _ELSEWHERE_M = 5.0, 0.4
# A landmark was seen from directions that spread so far [rad], or from distances of this ratio:
# from one pose, something behind a door could look the same.
_SPREAD_RAD, _SPREAD_RATIO = math.radians(15.0), 1.5
# The error of a place that all sightings share [m]: that of the map and of the calibration.
_SHARED_M = 0.02


@dataclass(frozen=True)
class ObjectSighting:
    """Where a thing was seen: `x`, `y` [m] in the map, covariance (2, 2), and from which pose."""

    x: float
    y: float
    covariance: Array
    robot: Pose


@dataclass(frozen=True)
class Requirements:
    """What a hypothesis needs to be proposed.

    `poses` is the number of robot poses that it was recognized from, `visits` how often the robot
    came back to it after not recognizing it for `away_s` [s].
    """

    poses: int
    visits: int
    away_s: float


@dataclass
class Hypothesis:
    """A thing that was never taught: its model, and where it was recognized.

    `seen` counts all recognitions, `first_ns` and `last_ns` are the times of the first and last
    one [ns].
    """

    model: ObjectModel
    sightings: list[ObjectSighting] = field(default_factory=list)
    seen: int = 0
    visits: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def add(self, stamp_ns: int, one: ObjectSighting, away_s: float) -> bool:
        """Add a sighting; return False if the thing is somewhere else than before."""
        if self.sightings:
            place, spread = self.place()
            off = np.array([one.x, one.y]) - place
            deviations = math.sqrt(float(off @ np.linalg.solve(spread + one.covariance, off)))
            away = math.hypot(*off.tolist())
            if deviations > _ELSEWHERE_DEVIATIONS and away > _ELSEWHERE_M:
                return False
            if deviations > _DEVIATIONS and away > _FLOOR_M:
                return True  # neither supports the place nor contradicts it
        if not self.seen or stamp_ns - self.last_ns > away_s * SECOND:
            self.visits += 1
        self.first_ns = self.first_ns or stamp_ns
        self.last_ns = stamp_ns
        self.seen += 1
        is_new = all(
            apart(one.robot, other.robot, _OTHER_M, _OTHER_RAD) for other in self.sightings
        )
        if is_new and len(self.sightings) < _MOST_SIGHTINGS:
            self.sightings.append(one)
        return True

    def place(self) -> tuple[Array, Array]:
        """Return the position (2,) [m] in the map by all sightings, and its covariance (2, 2)."""
        weights = [np.linalg.inv(one.covariance) for one in self.sightings]
        covariance = np.linalg.inv(np.sum(weights, axis=0))
        total = np.sum(
            [w @ (one.x, one.y) for w, one in zip(weights, self.sightings, strict=True)], axis=0
        )
        return covariance @ total, covariance + _SHARED_M**2 * np.eye(2)

    def meets(self, needs: Requirements) -> bool:
        """Return whether the thing was recognized often enough, and from places that differ."""
        if len(self.sightings) < needs.poses or self.visits < needs.visits:
            return False
        (x, y), _ = self.place()
        away = [(one.robot[0] - x, one.robot[1] - y) for one in self.sightings]
        directions = [math.atan2(dy, dx) for dx, dy in away]
        spread = max(abs(wrap(a - b)) for a in directions for b in directions)
        distances = [math.hypot(dx, dy) for dx, dy in away]
        return spread >= _SPREAD_RAD or max(distances) >= _SPREAD_RATIO * min(distances)


class Hypotheses:
    """The hypotheses by the identifiers of their models."""

    def __init__(self, needs: Requirements) -> None:
        self.needs = needs
        self._known: dict[int, Hypothesis] = {}

    def __contains__(self, object_id: int) -> bool:
        return object_id in self._known

    def __len__(self) -> int:
        return len(self._known)

    @property
    def models(self) -> list[ObjectModel]:
        """The models of all hypotheses."""
        return [one.model for one in self._known.values()]

    def add(self, model: ObjectModel) -> None:
        """Add a hypothesis; forget another one if there are too many."""
        while len(self._known) >= MOST_HYPOTHESES:
            least = min(self._known.values(), key=lambda one: (len(one.sightings), one.last_ns))
            self.remove(least.model.object_id)
        self._known[model.object_id] = Hypothesis(model)

    def remove(self, object_id: int) -> None:
        """Forget a hypothesis."""
        del self._known[object_id]

    def recognized(self, stamp_ns: int, seen: Sequence[tuple[int, ObjectSighting]]) -> bool:
        """Add what was recognized in an image; return whether hypotheses were forgotten.

        One that is visible twice in an image, or somewhere else than before, cannot be a landmark.
        """
        numbers = [object_id for object_id, _ in seen]
        gone = {one for one in numbers if numbers.count(one) > 1}
        for object_id, sighting in seen:
            hypothesis = self._known[object_id]
            if object_id not in gone and not hypothesis.add(stamp_ns, sighting, self.needs.away_s):
                gone.add(object_id)
        for object_id in gone:
            self.remove(object_id)
        return bool(gone)

    def take_proposed(self) -> list[Hypothesis]:
        """Remove and return the hypotheses that meet the requirements."""
        ready = [one for one in self._known.values() if one.meets(self.needs)]
        for one in ready:
            self.remove(one.model.object_id)
        return ready


def sighting_of(one: RecognizedObject, robot: Pose, covariance: Array) -> ObjectSighting:
    """Return where an object is that was recognized from a pose with a covariance (3, 3)."""
    direction = robot[2] + one.bearing
    cosine, sine = math.cos(direction), math.sin(direction)
    by_pose = np.array([[1.0, 0.0, -one.range * sine], [0.0, 1.0, one.range * cosine]])
    by_range = np.array([[cosine, -one.range * sine], [sine, one.range * cosine]])
    measured = np.asarray(one.covariance, np.float64).reshape(2, 2)
    spread = by_pose @ covariance @ by_pose.T + by_range @ measured @ by_range.T
    x, y = robot[0] + one.range * cosine, robot[1] + one.range * sine
    return ObjectSighting(x, y, spread + 1e-6 * np.eye(2), robot)
