"""The moments of figure 10 are found in what a pair wrote down."""

from __future__ import annotations

import numpy as np

from cairn.tools.experiments.sequence import ring, sequence_of
from cairn.tools.experiments.series import Evidence, Mapped, Place
from tests.cairn.tools.experiments.written import HERE, pair, registered, removed, world

OLD, NEW = (2.0, 0.0), (0.0, 3.0)
TRUTH = world((0.0, {3: OLD, 7: (1.0, 1.0)}), (10.0, {3: NEW, 7: (1.0, 1.0)}))


def seen(stamp: float, name: int, verdict: int, place: Place, reach: float) -> Evidence:
    return Evidence(
        stamp, name, 0.9 if verdict == 0 else 0.1, verdict, 0.1, place, reach, 0.0, HERE
    )


def test_a_map_that_is_repaired_goes_through_all_moments() -> None:
    made = pair(
        mapped=[
            Mapped(0.0, 3, OLD, True, 0.5),
            Mapped(0.0, 7, (1.0, 1.0), True, 0.5),
            Mapped(2.0, 7, (1.0, 1.0), True, 0.9),
            Mapped(4.0, 3, OLD, True, 0.98),
            Mapped(13.0, 3, OLD, True, 0.4),
            Mapped(14.0, 3, OLD, False, 0.1),
            Mapped(16.0, 3, NEW, True, 0.9),
        ],
        evidence=[
            seen(2.0, 7, 0, (1.0, 1.0), 1.4),
            seen(4.0, 3, 0, OLD, 2.0),
            seen(12.0, 3, 1, NEW, 3.0),
            seen(14.0, 3, 1, NEW, 3.0),
        ],
        changes=[removed(14.0, 3, OLD), registered(16.0, 3, NEW)],
    )

    moments = {moment.letter: moment for moment in sequence_of(made, TRUTH)}

    assert list(moments) == list("abcdefgh")
    stamps = [moment.stamp for moment in moments.values() if moment.stamp is not None]
    np.testing.assert_allclose(stamps, [0.0, 2.0, 2.0, 10.0, 12.0, 13.0, 14.0, 16.0])
    assert [moments[letter].of for letter in "beg"] == [7, 3, 3]
    assert {one.object_id: one.reliability for one in moments["b"].objects}[7] == 0.5
    assert moments["c"].title == "reliability of object 7 rises to 0.90"
    for letter, middle, reach in (("b", (1.0, 1.0), 1.4), ("e", OLD, 3.0), ("g", NEW, 3.0)):
        samples = moments[letter].samples
        assert samples is not None
        off = np.hypot(*(samples - middle).T)
        assert len(samples) == 300
        assert abs(float(np.median(off)) - reach) < 0.1
    assert not {one.object_id: one.live for one in moments["g"].objects}[3]
    assert {one.object_id: one.place for one in moments["h"].objects}[3] == NEW


def test_moments_that_never_came_have_no_time() -> None:
    made = pair(mapped=[Mapped(0.0, 3, OLD, True, 0.5)])

    moments = {moment.letter: moment for moment in sequence_of(made, TRUTH)}

    assert [letter for letter, one in moments.items() if one.stamp is not None] == ["a", "d"]


def test_new_samples_go_all_round() -> None:
    samples = ring((1.0, 2.0), 2.0, 1)

    angles = np.arctan2(samples[:, 1] - 2.0, samples[:, 0] - 1.0)
    assert all(((angles > low) & (angles < low + np.pi / 4)).any() for low in np.arange(-3.1, 2.3))
