"""What is remembered of scans, and what is not."""

import math

import numpy as np
import pytest

from components.motion_control.seen_space import SeenSpace
from components.motion_control.sweep import Sweep
from planar.poses import Pose

SECOND = 1_000_000_000
ANGLES = np.radians(np.arange(-135.0, 136.0))


def sweep(ranges: np.ndarray, at: Pose = (0, 0, 0)) -> Sweep:
    return Sweep(ranges, float(ANGLES[0]), math.radians(1), at, at)


def one_hit(bearing: float, distance: float) -> np.ndarray:
    ranges = np.full(ANGLES.size, np.inf)
    ranges[round(math.degrees(bearing)) + 135] = distance
    return ranges


def test_what_left_the_view_still_counts_for_a_while() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), sweep(one_hit(0.0, 1.0)))
    turned = (0.0, 0.0, math.pi)

    space.add(2 * SECOND, turned, sweep(one_hit(0.0, 2.0), turned))
    near = space.around(turned, 3.0)
    seen = sorted(near.points.round(6).tolist())
    space.add(4 * SECOND, turned, sweep(one_hit(0.0, 2.0), turned))
    later = space.around(turned, 3.0)

    assert seen == [[-1.0, 0.0], [2.0, 0.0]]
    assert near.nearest == 1.0
    assert later.points.round(6).tolist() == [[2.0, 0.0]]


def test_what_a_beam_passes_through_is_gone() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), sweep(one_hit(0.5, 1.0)))

    space.add(SECOND // 10, (0, 0, 0), sweep(np.full(ANGLES.size, np.inf)))

    assert len(space.around((0, 0, 0), 3.0).points) == 0


def test_a_beam_that_tells_nothing_clears_nothing() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), sweep(one_hit(0.5, 1.0)))

    space.add(SECOND // 10, (0, 0, 0), sweep(np.full(ANGLES.size, np.nan)))

    assert len(space.around((0, 0, 0), 3.0).points) == 1


def test_what_is_hidden_behind_something_is_kept() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), sweep(one_hit(0.0, 2.0)))

    space.add(SECOND // 10, (0, 0, 0), sweep(one_hit(0.0, 1.0)))

    assert sorted(space.around((0, 0, 0), 3.0).points[:, 0].round(6).tolist()) == [1.0, 2.0]


def test_a_robot_that_turns_during_a_scan_sees_things_in_their_places() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    middle = one_hit(0.0, 2.0)  # taken halfway between the two headings

    space.add(
        0, (0, 0, 0), Sweep(middle, float(ANGLES[0]), math.radians(1), (0, 0, 0), (0, 0, 0.2))
    )

    x, y = space.around((0, 0, 0), 3.0).points[0]
    assert math.atan2(y, x) == pytest.approx(0.1, abs=1e-6)


def test_only_what_was_seen_of_late_counts_as_seen() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    space.add(SECOND, (0, 0, 0), sweep(np.full(ANGLES.size, np.inf)))

    assert space.is_seen((0, 0, 0), 0.0, 0.5, 0)
    assert space.is_seen((0, 0, 0), math.pi / 2, 0.5, 0)
    assert not space.is_seen((0, 0, 0), math.pi, 0.5, 0)
    assert not space.is_seen((0, 0, 0), 0.0, 0.5, 2 * SECOND)


def test_scans_of_any_size_are_taken() -> None:
    space = SeenSpace(3 * SECOND, 0.22)

    space.add(0, (0, 0, 0), Sweep(np.empty(0), 0.0, 0.0, (0, 0, 0), (0, 0, 0)))
    space.add(1, (0, 0, 0), Sweep(np.array([1.0]), 0.0, 0.0, (0, 0, 0), (0, 0, 0)))
    for k in range(30):
        many = np.full(7200, 1.0 + 0.02 * k)
        space.add(2 + k, (0, 0, 0), Sweep(many, -math.pi, math.pi / 3600, (0, 0, 0), (0, 0, 0)))

    around = space.around((0, 0, 0), 3.0)
    assert len(around.points) <= 8192
    assert np.isfinite(around.points).all()


def test_what_is_to_come_counts_where_the_robot_may_meet_it() -> None:
    space = SeenSpace(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), sweep(np.full(ANGLES.size, np.inf)))
    space.expect(np.array([[1.0, 0.0, 0.4], [2.5, 0.0, 0.4], [0.1, 0.0, 1.4]]))

    around = space.around((0, 0, 0), 3.0, speed=0.6, fastest=0.6)

    assert around.points.tolist() == [[1.0, 0.0]]
    assert around.nearest == 3.0
