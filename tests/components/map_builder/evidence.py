"""Evidence as a robot that walks past an object gives it."""

from cairn.components.map_builder.objects import Evidence, MapObject, Verdict
from cairn.components.map_builder.place import Place

HERE = Place(2.0, 1.0, 1e-4, 0.0, 1e-4)
THERE = Place(3.5, 1.0, 0.02, 0.0, 0.02)


def surveyed(object_id: int = 7) -> MapObject:
    return MapObject(object_id, f"landmark {object_id}", HERE)


def sighting(
    similarity: float,
    step: int,
    implied: Place = HERE,
    verdict: Verdict | None = None,
    healthy: bool = True,
    object_id: int = 7,
    corroborated: bool = True,
) -> Evidence:
    """Evidence from the pose that is `step` times 0.2 m along the way."""
    if verdict is None:
        verdict = Verdict.AGREES if similarity >= 0.5 else Verdict.DISAGREES
    robot = (0.2 * step, 0.0, 0.0)
    return Evidence(object_id, similarity, verdict, 1.0, implied, robot, healthy, corroborated)
