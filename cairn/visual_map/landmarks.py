"""Landmarks: objects with a position in the map, the evidence about them, and changes of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from cairn.planar.poses import Pose

Cell = tuple[int, int]
"""A range of viewpoints of a landmark: sector of directions and band of distances."""

FARTHEST_M: Final = 1e7
"""Largest coordinate of a position in the map [m], as of the origin of a grid map."""

INITIAL_RELIABILITY = 0.5
"""Neutral reliability: nothing speaks for or against the position."""

CANDIDATE_RELIABILITY = 0.1
"""Reliability of a new candidate: that of the former position when it was removed."""

UNCORROBORATED_SIMILARITY = 0.45
"""Effective similarity of an uncorroborated disagreement.

It is just below neutral (0.5), so that a single gross error does not remove a landmark.
"""


class LandmarkState(IntEnum):
    """The constants of cairn_msgs/VisualObject."""

    LIVE = 0
    RELOCATING = 1


class ChangeKind(IntEnum):
    """The constants of cairn_msgs/VisualMapChange."""

    IMPORTED = 0
    REMOVED = 1
    REGISTERED = 2
    REFINED = 3
    RESTORED = 4


class EvidenceVerdict(IntEnum):
    """The constants of cairn_msgs/ObjectEvidence."""

    AGREES = 0
    DISAGREES = 1
    FALSE_MATCH = 2
    NOT_CONVERGED = 3
    UNSEEN = 4


@dataclass(frozen=True)
class MapPosition:
    """A position in the map [m] and its covariance [m^2]."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float

    def distance(self, other: MapPosition) -> float:
        """Return the distance of two positions [m]."""
        return math.hypot(self.x - other.x, self.y - other.y)


@dataclass(frozen=True)
class CandidatePosition:
    """A position to which a removed or unknown object may have moved, and its reliability.

    `observations` is the number of observations that support it, `seen_from` the robot's pose at
    the last one.
    """

    position: MapPosition
    reliability: float
    observations: int
    seen_from: Pose


@dataclass(frozen=True)
class Viewpoints:
    """How often a landmark was `seen` and `missed` from each cell while it stood at its position.

    `absent` are the cells from which it was not seen since it was last recognized: whether it was
    missed there, or is gone, is not known yet.
    """

    seen: tuple[tuple[Cell, int], ...] = ()
    missed: tuple[tuple[Cell, int], ...] = ()
    absent: tuple[Cell, ...] = ()


NO_VIEWPOINTS = Viewpoints()


@dataclass(frozen=True)
class PositionHistory:
    """The positions that a landmark has left, with times [s], and how often it came back.

    Until `ignored_until_s` no observation of it counts.
    """

    departures: tuple[tuple[MapPosition, float], ...] = ()
    returns: int = 0
    ignored_until_s: float = -math.inf


NO_HISTORY = PositionHistory()


@dataclass(frozen=True)
class LandmarkRecord:
    """The state of one object in the map; `position` is None until it was registered once.

    `judged_from` is the pose from which it was last judged by an observation, `missed_from` the one
    from which it was last not seen where it should have been. `uncorroborated` counts the
    uncorroborated disagreements since it last agreed.
    """

    object_id: int
    name: str
    position: MapPosition | None
    reliability: float = INITIAL_RELIABILITY
    state: LandmarkState = LandmarkState.LIVE
    evidence_count: int = 0
    candidate: CandidatePosition | None = None
    judged_from: Pose | None = None
    viewpoints: Viewpoints = NO_VIEWPOINTS
    missed_from: Pose | None = None
    history: PositionHistory = NO_HISTORY
    uncorroborated: int = 0


@dataclass(frozen=True)
class LandmarkEvidence:
    """The message `ObjectEvidence` about a landmark, with the robot's pose that it was made with.

    `implied` is the position of the object by this observation, `robot` the robot's pose at that
    time, and `healthy` whether that pose was reliable. `corroborated` is False for a disagreement
    that no other observations support yet.
    """

    object_id: int
    similarity: float
    verdict: EvidenceVerdict
    distance: float
    implied: MapPosition
    robot: Pose
    healthy: bool
    corroborated: bool = True

    @property
    def stands_alone(self) -> bool:
        """Return whether this is a disagreement that no other observations support yet."""
        return self.verdict is EvidenceVerdict.DISAGREES and not self.corroborated

    @property
    def effective_similarity(self) -> float:
        """Return the similarity that counts: nearly neutral for an uncorroborated disagreement."""
        return UNCORROBORATED_SIMILARITY if self.stands_alone else self.similarity


@dataclass(frozen=True)
class LandmarkChange:
    """A change of the map: kind, positions before and after, reliability, and the reason."""

    object_id: int
    kind: ChangeKind
    old: MapPosition | None
    new: MapPosition | None
    reliability: float
    reason: str


def new_landmark(object_id: int) -> LandmarkRecord:
    """Return the record of an object that is not in the map yet and has no position."""
    return LandmarkRecord(
        object_id,
        f"object {object_id}",
        None,
        reliability=CANDIDATE_RELIABILITY,
        state=LandmarkState.RELOCATING,
    )
