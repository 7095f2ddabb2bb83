"""Whether a scan contradicts what was seen: only surfaces that stand still count."""

import numpy as np

from cairn.components.slam.contradiction import contradicts, standing
from cairn.components.slam.point_cloud import PointCloud, joined

HERE = (0.0, 0.0, 0.0)


def wall(x: float, low: float, high: float) -> PointCloud:
    """A wall that faces the scanner, which looks along x."""
    y = np.arange(low, high, 0.05)
    points = np.column_stack((np.full(y.size, x), y))
    return PointCloud(points, np.tile((-1.0, 0.0), (y.size, 1)))


def test_scan_that_sees_through_a_wall_contradicts_it() -> None:
    assert contradicts(wall(2.0, -2.0, 2.0), wall(4.0, -4.0, 4.0), HERE)
    assert not contradicts(wall(2.0, -2.0, 2.0), wall(2.1, -4.0, 4.0), HERE)


def test_scan_of_a_new_wall_beside_the_known_one_does_not_contradict_it() -> None:
    new = joined([wall(2.0, -2.0, -1.0), wall(6.0, 2.0, 9.0)])

    assert not contradicts(wall(2.0, -2.0, 1.0), new, HERE)


def test_people_who_leave_or_hide_a_part_do_not_contradict_the_place() -> None:
    two = joined([wall(1.5, -1.5, -1.0), wall(1.5, 0.3, 0.8)])

    assert not contradicts(two, wall(4.0, -4.0, 4.0), HERE)
    assert not contradicts(
        wall(4.0, -4.0, 4.0), joined([two, wall(4.0, -1.5, 0.6), wall(4.0, 2.5, 4.0)]), HERE
    )


def test_scan_from_a_smaller_room_contradicts_the_place() -> None:
    assert contradicts(wall(4.0, -4.0, 4.0), wall(2.0, -2.0, 2.0), HERE)


def test_only_what_several_keyframes_saw_stands_still() -> None:
    walking = [wall(1.0, 0.4 * k, 0.4 * k + 0.3) for k in range(6)]
    clouds = [joined([wall(3.0, -2.0, 2.0), person]) for person in walking]

    assert set(standing(clouds).points[:, 0].tolist()) == {3.0}
    assert standing(clouds[:1]).count == clouds[0].count
