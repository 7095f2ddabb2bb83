"""The panels of figure 10 are found in the series of a method."""

from __future__ import annotations

import numpy as np

from cairn_lab.experiments.map_sequence import map_panels, ring_of_particles
from cairn_lab.experiments.series import Position, RecordedEvidence, RecordedLandmark
from lab_tests.experiments.recorded import (
    ORIGIN,
    method_series,
    registration,
    removal,
    world_series,
)
from tests.wording import assert_words

OLD, NEW = (2.0, 0.0), (0.0, 3.0)
TRUTH = world_series((0.0, {3: OLD, 7: (1.0, 1.0)}), (10.0, {3: NEW, 7: (1.0, 1.0)}))


def evidence(
    stamp: float, object_id: int, verdict: int, position: Position, range_m: float
) -> RecordedEvidence:
    similarity = 0.9 if verdict == 0 else 0.1
    return RecordedEvidence(
        stamp, object_id, similarity, verdict, 0.1, position, range_m, 0.0, ORIGIN
    )


def test_repaired_map_has_all_panels() -> None:
    series = method_series(
        landmarks=[
            RecordedLandmark(0.0, 3, OLD, True, 0.5),
            RecordedLandmark(0.0, 7, (1.0, 1.0), True, 0.5),
            RecordedLandmark(2.0, 7, (1.0, 1.0), True, 0.9),
            RecordedLandmark(4.0, 3, OLD, True, 0.98),
            RecordedLandmark(13.0, 3, OLD, True, 0.4),
            RecordedLandmark(14.0, 3, OLD, False, 0.1),
            RecordedLandmark(16.0, 3, NEW, True, 0.9),
        ],
        evidence=[
            evidence(2.0, 7, 0, (1.0, 1.0), 1.4),
            evidence(4.0, 3, 0, OLD, 2.0),
            evidence(12.0, 3, 1, NEW, 3.0),
            evidence(14.0, 3, 1, NEW, 3.0),
        ],
        changes=[removal(14.0, 3, OLD), registration(16.0, 3, NEW)],
    )

    panels = {panel.letter: panel for panel in map_panels(series, TRUTH)}

    assert list(panels) == list("abcdefgh")
    stamps = [panel.stamp for panel in panels.values() if panel.stamp is not None]
    np.testing.assert_allclose(stamps, [0.0, 2.0, 2.0, 10.0, 12.0, 13.0, 14.0, 16.0])
    assert [panels[letter].object_id for letter in "beg"] == [7, 3, 3]
    assert {one.object_id: one.reliability for one in panels["b"].landmarks}[7] == 0.5
    assert_words(panels["c"].title, "object 7", "0.90")
    for letter, center, range_m in (("b", (1.0, 1.0), 1.4), ("e", OLD, 3.0), ("g", NEW, 3.0)):
        particles = panels[letter].particles
        assert particles is not None
        off = np.hypot(*(particles - center).T)
        assert len(particles) == 300
        assert abs(float(np.median(off)) - range_m) < 0.1
    assert not {one.object_id: one.live for one in panels["g"].landmarks}[3]
    assert {one.object_id: one.position for one in panels["h"].landmarks}[3] == NEW


def test_panels_of_events_that_did_not_happen_have_no_stamp() -> None:
    series = method_series(landmarks=[RecordedLandmark(0.0, 3, OLD, True, 0.5)])

    panels = {panel.letter: panel for panel in map_panels(series, TRUTH)}

    assert [letter for letter, one in panels.items() if one.stamp is not None] == ["a", "d"]


def test_new_particles_surround_the_landmark() -> None:
    particles = ring_of_particles((1.0, 2.0), 2.0, 1)

    angles = np.arctan2(particles[:, 1] - 2.0, particles[:, 0] - 1.0)
    assert all(((angles > low) & (angles < low + np.pi / 4)).any() for low in np.arange(-3.1, 2.3))
