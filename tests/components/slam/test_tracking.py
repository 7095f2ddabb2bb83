"""Tracking: odometry is trusted where scans do not contradict it, and no further."""

import math

import numpy as np

from cairn.components.slam.keyframes import scan_cloud
from cairn.components.slam.point_cloud import PointCloud, joined
from cairn.components.slam.tracking import ScanTracker, Tracked
from cairn.planar.poses import Pose, apart
from tests.components.slam import courses
from tests.components.slam.recordings import SCANNERS, Leg, record


def started() -> tuple[ScanTracker, list[PointCloud]]:
    """A tracker in an office, and the scans of a short drive there."""
    legs = [Leg([(1.0, 6.0), (2.0, 6.0)]), Leg([(17.0, 9.0), (17.5, 9.0)])]
    recording = record(courses.shipped("office"), SCANNERS["UST-10LX"], legs=legs)
    clouds = [scan_cloud(rays, 30.0) for rays in recording.rays]
    elsewhere = recording.legs.index(1)
    tracker = ScanTracker()
    tracker.set_surroundings(clouds[0])
    return tracker, [clouds[0], clouds[elsewhere]]


def wall(begin: float, end: float) -> PointCloud:
    """A wall 2 m before the robot, from `begin` to `end` [m] on its left."""
    y = np.arange(begin, end, 0.04)
    return PointCloud(np.column_stack((np.full(y.size, 2.0), y)), np.tile((-1.0, 0.0), (y.size, 1)))


def turned(cloud: PointCloud) -> PointCloud:
    return cloud.placed((0.0, 0.0, math.pi / 2))


def test_wheels_that_slipped_do_not_lead_astray() -> None:
    tracker, (here, _) = started()
    for step in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.25), (0.15, 0.0, 0.0)):
        tracked = tracker.track((0.0, 0.0, 0.0), step, here)
        assert not apart(tracked.pose, (0.0, 0.0, 0.0), 0.02, 0.01)


def test_a_robot_that_was_moved_is_lost_after_four_scans() -> None:
    tracker, (here, elsewhere) = started()
    still = (0.0, 0.0, 0.0)
    assert not tracker.track(still, still, here).is_misfit
    misfits = [tracker.track(still, still, elsewhere) for _ in range(4)]
    assert all(tracked.is_misfit for tracked in misfits)
    assert [tracked.is_lost for tracked in misfits] == [False, False, False, True]
    assert misfits[0].pose == still


def seen_little_by_little(step: Pose) -> list[Tracked]:
    """What the tracker says of scans that show, one after the other, more of a wall that is new."""
    tracker = ScanTracker()
    tracker.set_surroundings(wall(-3.0, 3.0))
    pose: Pose = (0.0, 0.0, 0.0)
    found = []
    for k in range(20):
        found.append(tracker.track(pose, step, wall(-3.0 + 0.3 * k, 3.0 + 0.3 * k)))
        pose = found[-1].pose
    return found


def test_a_new_place_does_not_mean_that_the_robot_was_moved() -> None:
    tracked = seen_little_by_little((0.0, 0.05, 0.0))

    misfits = [one.is_misfit for one in tracked]
    assert any(misfits[k : k + 4] == [True, True, True, False] for k in range(16))
    assert tracked[-1].fit is None or tracked[-1].is_misfit
    assert not any(one.is_lost for one in tracked)


def test_a_robot_that_comes_to_a_new_place_while_its_wheels_stand_was_moved() -> None:
    tracked = seen_little_by_little((0.0, 0.0, 0.0))

    lost = [one.is_lost for one in tracked].index(True)
    assert [one.is_misfit for one in tracked[lost - 4 : lost + 1]] == [
        False,
        True,
        True,
        True,
        True,
    ]


def test_few_surfaces_do_not_show_that_wheels_have_slipped() -> None:
    moved = []
    for length in (1.2, 3.0):
        corner = joined([wall(0.0, length), turned(wall(0.0, length))])
        tracker = ScanTracker()
        tracker.set_surroundings(corner)
        tracker.track((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), corner)
        moved.append(tracker.track((0.0, 0.0, 0.0), (0.2, 0.0, 0.0), corner).pose[0])

    assert moved[0] > 0.1
    assert abs(moved[1]) < 0.05


def test_a_robot_that_sees_nothing_where_it_saw_something_before_was_moved() -> None:
    tracker = ScanTracker()
    still = (0.0, 0.0, 0.0)
    ahead = wall(-1.0, 1.0)
    behind = ahead.placed((0.0, 0.0, math.pi))
    tracker.set_surroundings(ahead)
    tracker.track(still, still, ahead)

    tracked = [tracker.track(still, still, behind) for _ in range(4)]

    assert [one.is_lost for one in tracked] == [False, False, False, True]


def test_the_uncertainty_of_steps_without_a_fit_adds_up() -> None:
    tracker = ScanTracker()
    nothing = PointCloud(np.zeros((0, 2)), np.zeros((0, 2)))
    step: Pose = (0.1, 0.0, 0.0)
    one, two = (tracker.track((0.0, 0.0, 0.0), step, nothing) for _ in range(2))
    assert one.fit is None
    assert math.isclose(one.information[0, 0], 2 * two.information[0, 0], rel_tol=1e-9)
