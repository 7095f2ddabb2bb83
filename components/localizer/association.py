"""Which object of the map each sighting is of, where pictures alone cannot tell."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from cairn.components.localizer.object_likelihood import Landmark, Sighting
from cairn.components.localizer.particles import Estimate
from cairn.components.localizer.similarity import GATE, innovation

# By so much [NIS] one object must explain a sighting better than another that looks like it.
_CLEARLY = 6.0


def associated(
    sightings: Sequence[Sighting], pose: Estimate | None, landmarks: Mapping[int, Landmark]
) -> list[Sighting]:
    """The sightings that are of one object for certain, each under that object's identifier.

    A sighting with alternatives is of the one that stands where it was seen from `pose`; of
    several sightings of one object in one image the one counts that is where the object stands.
    What stays in doubt is left out, all of it if there is no pose.
    """
    certain: list[Sighting] = []
    for one in sightings:
        names = (one.object_id, *one.alternatives)
        options = [replace(one, object_id=name, alternatives=()) for name in names]
        certain += options if len(options) == 1 else _clearest(options, pose, landmarks)
    kept: list[Sighting] = []
    for object_id in dict.fromkeys(one.object_id for one in certain):
        instances = [one for one in certain if one.object_id == object_id]
        kept += instances if len(instances) == 1 else _clearest(instances, pose, landmarks)
    return kept


def _clearest(
    options: Iterable[Sighting], pose: Estimate | None, landmarks: Mapping[int, Landmark]
) -> list[Sighting]:
    """The one of the options that agrees with the map, if it does so clearly best; or none."""
    if pose is None:
        return []
    live = [one for one in options if one.object_id in landmarks and landmarks[one.object_id].live]
    ranked = sorted(
        ((innovation(pose, one, landmarks[one.object_id]).nis, k) for k, one in enumerate(live))
    )
    if not ranked or ranked[0][0] > GATE:
        return []
    if len(ranked) > 1 and ranked[1][0] < ranked[0][0] + _CLEARLY:
        return []
    return [live[ranked[0][1]]]
