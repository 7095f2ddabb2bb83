"""Evidence from a robot that drives past a landmark."""

from cairn.visual_map.landmarks import (
    EvidenceVerdict,
    LandmarkEvidence,
    LandmarkRecord,
    MapPosition,
)

HERE = MapPosition(2.0, 1.0, 1e-4, 0.0, 1e-4)
THERE = MapPosition(3.5, 1.0, 0.02, 0.0, 0.02)


def surveyed(object_id: int = 7) -> LandmarkRecord:
    return LandmarkRecord(object_id, f"landmark {object_id}", HERE)


def observation(
    similarity: float,
    step: int,
    implied: MapPosition = HERE,
    verdict: EvidenceVerdict | None = None,
    healthy: bool = True,
    object_id: int = 7,
    corroborated: bool = True,
) -> LandmarkEvidence:
    """Return evidence from the pose that is `step` times 0.2 m along the path."""
    if verdict is None:
        verdict = EvidenceVerdict.AGREES if similarity >= 0.5 else EvidenceVerdict.DISAGREES
    robot = (0.2 * step, 0.0, 0.0)
    return LandmarkEvidence(
        object_id, similarity, verdict, 1.0, implied, robot, healthy, corroborated
    )
