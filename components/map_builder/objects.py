"""The objects of the visual map, the evidence for and against them, and changes of the map."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from cairn.components.map_builder.place import Place
from cairn.components.map_builder.reliability import INITIAL
from cairn.components.map_builder.stays import NONE, Stays
from cairn.components.map_builder.viewpoints import NOWHERE, Viewpoints
from cairn.planar.poses import Pose

# A candidate begins with the reliability that its old place had when it was removed.
CARRIED_OVER = 0.1
# The similarity that an uncorroborated disagreement counts as: just below neutral (0.5), so that
# a single gross error does not remove an object.
UNCORROBORATED = 0.45


class State(IntEnum):
    """As the constants of cairn_msgs/VisualObject."""

    LIVE = 0
    RELOCATING = 1


class Kind(IntEnum):
    """As the constants of cairn_msgs/VisualMapChange."""

    IMPORTED = 0
    REMOVED = 1
    REGISTERED = 2
    REFINED = 3
    RESTORED = 4


class Verdict(IntEnum):
    """As the constants of cairn_msgs/ObjectEvidence."""

    AGREES = 0
    DISAGREES = 1
    FALSE_MATCH = 2
    NOT_CONVERGED = 3
    UNSEEN = 4


@dataclass(frozen=True)
class Candidate:
    """A place that a removed object may have moved to."""

    place: Place
    reliability: float
    sightings: int
    seen_from: Pose


@dataclass(frozen=True)
class MapObject:
    """One object: `place` is None until it was ever registered.

    `judged_from` is the pose from which it was last judged by a sighting, `missed_from` the one
    from which it was last not seen where it should have been. `held_back` counts disagreements
    that stood alone, and so hardly counted, since it last agreed.
    """

    object_id: int
    name: str
    place: Place | None
    reliability: float = INITIAL
    state: State = State.LIVE
    evidence_count: int = 0
    candidate: Candidate | None = None
    judged_from: Pose | None = None
    viewpoints: Viewpoints = NOWHERE
    missed_from: Pose | None = None
    stays: Stays = NONE
    held_back: int = 0


@dataclass(frozen=True)
class Evidence:
    """The evidence of one observation, or of a missing one, and the robot's pose at that time.

    `corroborated` is False for a disagreement that no others bear out yet.
    """

    object_id: int
    similarity: float
    verdict: Verdict
    distance: float
    implied: Place
    robot: Pose
    healthy: bool
    corroborated: bool = True

    @property
    def alone(self) -> bool:
        """Whether this is a disagreement that no other observations corroborate yet."""
        return self.verdict is Verdict.DISAGREES and not self.corroborated

    @property
    def weight(self) -> float:
        """The similarity as it counts: a disagreement that stands alone hardly counts."""
        return UNCORROBORATED if self.alone else self.similarity


@dataclass(frozen=True)
class Change:
    """A change of the map: kind, places before and after, reliability, the reason in words."""

    object_id: int
    kind: Kind
    old: Place | None
    new: Place | None
    reliability: float
    reason: str


def unknown(object_id: int, name: str | None = None) -> MapObject:
    """An object that the map does not hold: it has yet to be placed."""
    return MapObject(
        object_id,
        name or f"object {object_id}",
        None,
        reliability=CARRIED_OVER,
        state=State.RELOCATING,
    )
