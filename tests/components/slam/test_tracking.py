"""Tracking: odometry is trusted where scans do not contradict it, and no further."""

import math

import numpy as np

from cairn.components.slam.keyframes import Keyframe, scan_cloud, scan_rays, scan_surfaces
from cairn.components.slam.recent_surfaces import RecentSurfaces
from cairn.components.slam.tracking import ScanTracker, Tracked
from cairn.planar.poses import Pose, apart
from cairn.planar.scans import Rays
from tests.components.slam import courses
from tests.components.slam.recordings import SCANNERS, Leg, record

STILL: Pose = (0.0, 0.0, 0.0)


def surroundings(rays: list[Rays]) -> RecentSurfaces:
    """What scans from the origin show."""
    frames = [
        Keyframe(0, STILL, scan_surfaces(scan_cloud(one, 30.0)), scan_rays(one), 0) for one in rays
    ]
    recent = RecentSurfaces()
    recent.show(range(len(frames)), frames, np.zeros((len(frames), 3)))
    return recent


def started() -> tuple[ScanTracker, Rays, Rays]:
    """A tracker in an office, a scan from there, and one from another room."""
    legs = [Leg([(1.0, 6.0), (2.0, 6.0)]), Leg([(17.0, 9.0), (17.5, 9.0)])]
    recording = record(courses.shipped("office"), SCANNERS["UST-10LX"], legs=legs)
    tracker = ScanTracker()
    tracker.set_surroundings(surroundings(recording.rays[:3]))
    return tracker, recording.rays[0], recording.rays[recording.legs.index(1)]


def tracked(tracker: ScanTracker, step: Pose, rays: Rays) -> Tracked:
    """The result of a scan, after a step of odometry from the origin."""
    return tracker.track(STILL, step, scan_cloud(rays, 30.0), rays)


def with_people(rays: Rays, distance: float, share: float, shift: float = 0.0) -> Rays:
    """The rays, of which a share in the middle is hidden by something at a distance [m]."""
    count = len(rays.ranges)
    middle = count // 2 + round(shift * count)
    hidden = slice(middle - round(share * count / 2), middle + round(share * count / 2))
    ranges = rays.ranges.copy()
    ranges[hidden] = np.fmin(ranges[hidden], distance)
    return Rays(rays.starts, rays.angles, ranges, rays.reach)


def test_wheels_that_slipped_do_not_lead_astray() -> None:
    tracker, here, _ = started()
    for step in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.25), (0.15, 0.0, 0.0)):
        assert not apart(tracked(tracker, step, here).pose, STILL, 0.02, 0.01)


def test_a_robot_that_was_moved_is_lost_after_four_scans() -> None:
    tracker, here, elsewhere = started()
    assert not tracked(tracker, STILL, here).is_misfit
    misfits = [tracked(tracker, STILL, elsewhere) for _ in range(4)]
    assert all(one.is_misfit for one in misfits)
    assert [one.is_lost for one in misfits] == [False, False, False, True]
    assert misfits[0].pose == STILL


def test_people_who_surround_the_robot_do_not_mean_that_it_was_moved() -> None:
    tracker, here, _ = started()
    tracked(tracker, STILL, here)
    crowd = with_people(here, 0.5, 0.55)
    results = [tracked(tracker, STILL, crowd) for _ in range(20)]
    assert not any(one.is_lost for one in results)
    assert not any(apart(one.pose, STILL, 0.02, 0.01) for one in results)


def test_what_moves_beside_the_robot_is_no_surface() -> None:
    _, here, _ = started()
    recent = surroundings([here, here, here, with_people(here, 0.6, 0.2)])
    near = np.hypot(*(recent.cloud.points - here.starts[0]).T) < 0.65
    assert not near.any()
    assert surroundings([with_people(here, 0.6, 0.2)]).cloud.count > 0


def test_surfaces_that_people_hide_are_not_passed() -> None:
    _, here, elsewhere = started()
    recent = surroundings([here])
    assert recent.passed_share(STILL, with_people(here, 0.5, 0.6)) == 0.0
    assert recent.passed_share(STILL, elsewhere) > 0.25


def test_a_scan_of_what_was_never_seen_says_nothing() -> None:
    tracker, here, _ = started()
    tracked(tracker, STILL, here)
    far = tracker.track((100.0, 0.0, 0.0), STILL, scan_cloud(here, 30.0), here)
    assert far.fit is None
    assert not far.is_misfit
    assert far.pose == (100.0, 0.0, 0.0)


def test_the_uncertainty_of_steps_without_a_fit_adds_up() -> None:
    tracker, (_, here, _) = ScanTracker(), started()
    nothing = Rays(here.starts, here.angles, np.full(len(here.ranges), np.inf), here.reach)
    one, two = (tracked(tracker, (0.1, 0.0, 0.0), nothing) for _ in range(2))
    assert one.fit is None
    assert math.isclose(one.information[0, 0], 2 * two.information[0, 0], rel_tol=1e-9)
