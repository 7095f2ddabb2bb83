"""Recent scans, the global search, wheel slip, and the confirmation of what was found."""

import math
from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.components.localizer.config import LocalizationSettings
from cairn.components.localizer.global_search import RecentMeasurements, search
from cairn.components.localizer.likelihood_field import ScanMap
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.odometry import MeasuredTrack
from cairn.components.localizer.pose_differences import PLACE_M
from cairn.components.localizer.recent_observations import RecentObservations
from cairn.components.localizer.scan_fit import RecentScans
from cairn.planar.grid import OccupancyCells
from cairn.planar.motion_model import MotionModel
from cairn.planar.poses import Pose, compose, relative, wrap
from cairn.visual_map.observations import Observation
from tests.components.localizer.room import Box, Moment, apart, drive, room, scanned
from tests.sweeps import sampled

START = (2.0, 2.0, 0.0)
ELSEWHERE = (6.8, 5.5, 2.0)
# Turned half round it looks the same.
SYMMETRIC: tuple[Box, ...] = ((1.0, 1.0, 2.0, 2.0), (7.0, 5.0, 8.0, 6.0))
# A pillar, 15 cm wide, is the only difference.
ALMOST_SYMMETRIC = (*SYMMETRIC, (4.0, 3.4, 4.15, 3.55))
SCAN_SHARE = 0.14
# Positions of eight objects on the walls [m]; after a few meters each robot has observed several.
ON_WALLS = ((2, 0), (5, 0), (9, 2), (9, 5), (7, 7), (3, 7), (0, 5), (0, 2))
Array = NDArray[np.float64]


def evidence(grid: OccupancyCells, *poses: Pose, seed: int = 0) -> RecentMeasurements:
    """Return the measurements of a robot that drove through these poses, with exact odometry."""
    random = np.random.default_rng(seed)
    scans = RecentScans()
    for pose in poses:
        scans.add(scanned(grid, pose, random, beams=60), relative(poses[0], pose))
    now = relative(poses[0], poses[-1])
    return RecentMeasurements(
        RecentObservations(), scans, {}, ScanMap(grid, 0.1, 0.05), SCAN_SHARE, now, 0.0
    )


def robot(grid: OccupancyCells, seed: int = 0) -> Localization:
    model = MotionModel(0.0, 0.0, 0.02, 0.04, 0.03)
    one = Localization(
        LocalizationSettings(particles=500, motion=model),
        MeasuredTrack(),
        np.random.default_rng(seed),
    )
    one.set_grid(grid)
    return one


def through(one: Localization, moment: Moment) -> bool:
    one.add_odometry(moment.time, moment.odometry, 0.0, 0.0)
    return one.fuse_scan(moment.time, moment.points)


def test_recent_scans_are_from_different_poses() -> None:
    scans = RecentScans(keep=3)
    for k in range(20):
        scans.add(np.array([[1.0, 0.0]]), (0.1 * k, 0.0, 0.0))
    assert len(scans) == 3

    scans.clear()
    for _ in range(20):
        scans.add(np.array([[1.0, 0.0]]), (0.0, 0.0, 0.0))
    assert len(scans) <= 2


def test_recent_scans_are_transformed_to_their_poses() -> None:
    grid = room()
    poses = [(2.0, 2.0, 0.0), (2.5, 2.0, 0.2), (3.0, 2.1, 0.4)]
    seen = evidence(grid, *poses)

    true, off = np.array([poses[-1]]).T, np.array([(3.3, 2.1, 0.4)]).T

    assert seen.map is not None
    assert seen.scans.fit(poses[-1], seen.now, seen.map.field) > 0.95
    assert seen.log_likelihood(true)[0] > seen.log_likelihood(off)[0] + 5.0


@pytest.mark.parametrize("seed", sampled(range(3)))
def test_search_finds_the_pose_that_explains_the_scans(seed: int) -> None:
    seen = evidence(room(), (2.0, 2.0, 0.3), (2.5, 2.1, 0.5), (2.9, 2.4, 1.0), seed=seed)

    found = search(seen, 5000, np.random.default_rng(seed))

    assert found is not None
    away, turned = apart(found.pose.mean, (2.9, 2.4, 1.0))
    assert away < 0.15
    assert turned < 0.1
    assert seen.fit(found.pose) > 0.9


@pytest.mark.parametrize("seed", sampled(range(5), 2))
def test_two_lookalike_positions_share_the_posterior(seed: int) -> None:
    seen = evidence(room(SYMMETRIC), (3.0, 3.0, 0.3), (3.4, 3.2, 0.5), seed=seed)

    found = search(seen, 5000, np.random.default_rng(seed))

    assert found is not None
    assert found.share < 0.9
    tops = [tuple(mode.mean(axis=1)) for mode in found.modes[:4]]
    for alike in ((3.4, 3.2, 0.5), (9.0 - 3.4, 7.0 - 3.2, 0.5 + math.pi)):
        assert min(apart(top, alike)[0] for top in tops) < 0.5 * PLACE_M


def test_search_without_measurements_finds_nothing() -> None:
    nothing = RecentMeasurements(
        RecentObservations(), RecentScans(), {}, None, 0.1, (0.0, 0.0, 0.0), 0.0
    )

    assert search(nothing, 1000, np.random.default_rng(0)) is None


@pytest.mark.accuracy
@pytest.mark.slow
@pytest.mark.parametrize("seed", sampled(range(3)))
def test_robot_in_a_symmetric_room_is_not_located(seed: int) -> None:
    grid = room(SYMMETRIC)
    one = robot(grid, seed)

    for moment in drive(grid, (3.0, 3.0, 0.3), 20.0, seed):
        through(one, moment)

    assert not one.located or one.health().value < 0.5
    assert one.health().reason.text


@pytest.mark.parametrize("seed", sampled(range(3)))
def test_found_robot_is_confirmed_when_nothing_else_is_probable(seed: int) -> None:
    grid = room()
    one = robot(grid, seed)
    values: list[float] = []

    for moment in drive(grid, START, 20.0, seed):
        through(one, moment)
        if one.located:
            values.append(one.health().value)
            assert apart(one.pose().mean, moment.pose)[0] < 0.4

    assert values[0] < 0.5
    assert values[-1] > 0.9


@pytest.mark.parametrize("slip", [(0.4, 0.1, 0.0), (0.0, 0.0, 0.5), (-0.3, 0.2, -0.4)])
def test_wheel_slip_is_corrected_at_once(slip: Pose) -> None:
    grid = room()
    one = robot(grid)
    one.set_pose(START, np.diag([0.01**2, 0.01**2, 0.01**2]))
    slipped = compose(START, slip)
    random = np.random.default_rng(1)

    for k in count():
        here = START if k < 5 else slipped
        one.add_odometry(0.1 * k, (0.0, 0.0, 0.0), 0.0, 0.0)
        one.fuse_scan(0.1 * k, scanned(grid, here, random))
        if k == 20:
            break

    away, turned = apart(one.pose().mean, slipped)
    assert away < 0.08
    assert turned < 0.05
    assert "may also be" not in one.health().reason.text


def test_people_around_the_robot_do_not_count_as_wheel_slip() -> None:
    grid = room()
    random = np.random.default_rng(2)
    one = robot(grid)
    one.set_pose(START, np.diag([0.01**2, 0.01**2, 0.01**2]))

    for k in range(20):
        points = scanned(grid, START, random, beams=60)
        hidden = random.random(len(points)) < 0.5
        points[hidden] *= random.uniform(0.2, 0.8, (int(hidden.sum()), 1))
        one.add_odometry(0.1 * k, (0.0, 0.0, 0.0), 0.0, 0.0)
        one.fuse_scan(0.1 * k, points)
        away, turned = apart(one.pose().mean, START)
        assert away < 0.08
        assert turned < 0.05


@pytest.mark.parametrize("seed", sampled(range(3)))
def test_kidnapped_robot_has_low_health_until_it_is_found(seed: int) -> None:
    grid = room()
    one = robot(grid, seed)
    one.set_pose(START, np.diag([0.01**2, 0.01**2, 0.01**2]))
    moments = list(drive(grid, START, 5.0, seed))
    # Set down elsewhere, odometry knows nothing of it.
    last = moments[-1]
    for moment in drive(grid, ELSEWHERE, 25.0, seed + 10):
        odometry = compose(last.odometry, moment.odometry)
        moments.append(Moment(last.time + 0.1 + moment.time, moment.pose, odometry, moment.points))

    wrong = 0
    for moment in moments:
        through(one, moment)
        away = apart(one.pose().mean, moment.pose)[0]
        wrong += away > 0.5 and one.health().value >= 0.5

    assert apart(one.pose().mean, moments[-1].pose)[0] < 0.2
    # The running mean of the fit takes a few scans to fall.
    assert wrong <= 8


def exchanged_objects(pose: Pose, turned: tuple[int, ...] = ()) -> list[Observation]:
    """Return those in view: each object is now where the map has the second one after it.

    Of those in `turned` it is the one opposite.
    """
    seen = []
    for object_id in range(len(ON_WALLS)):
        x, y = ON_WALLS[(object_id + (4 if object_id in turned else 2)) % len(ON_WALLS)]
        far = math.hypot(x - pose[0], y - pose[1])
        bearing = wrap(math.atan2(y - pose[1], x - pose[0]) - pose[2])
        if far < 4.0 and abs(bearing) < 0.6:
            seen.append(Observation(object_id, far, bearing, 0.05**2, 0.02**2))
    return seen


def through_exchanged_objects(
    one: Localization,
    grid: OccupancyCells,
    seed: int,
    turned: tuple[int, ...] = (),
) -> Iterator[Moment]:
    """Yield each moment of a drive of 40 s among exchanged objects, once it is fused."""
    one.set_landmarks(Landmark(key, *at, reliability=0.95) for key, at in enumerate(ON_WALLS))
    for moment in drive(grid, ELSEWHERE, 40.0, seed):
        through(one, moment)
        if round(10 * moment.time) % 2 == 0:
            one.fuse_objects(moment.time, exchanged_objects(moment.pose, turned))
        yield moment


@pytest.mark.accuracy
@pytest.mark.parametrize("seed", sampled(range(2)))
@pytest.mark.parametrize("start", sampled([START, None]), ids=["carried", "unknown start"])
def test_scans_decide_against_objects_that_were_exchanged(start: Pose | None, seed: int) -> None:
    grid = room()
    one = robot(grid, seed)
    if start is not None:
        one.set_pose(start, np.diag([0.01**2, 0.01**2, 0.01**2]))

    *_, last = through_exchanged_objects(one, grid, seed)

    assert apart(one.pose().mean, last.pose)[0] < 0.2


@pytest.mark.accuracy
def test_exchanged_objects_in_a_symmetric_room_locate_no_robot() -> None:
    grid = room(SYMMETRIC)
    one = robot(grid)
    one.set_pose((4.5, 1.0, 0.0), np.diag([0.01**2, 0.01**2, 0.01**2]))

    for _ in through_exchanged_objects(one, grid, seed=0):
        pass

    assert one.health().value < 0.5


@pytest.mark.accuracy
@pytest.mark.parametrize("turned", [(6,), (2, 6)])
def test_object_that_agrees_with_a_lookalike_moves_no_robot_there(turned: tuple[int, ...]) -> None:
    grid = room(ALMOST_SYMMETRIC)
    one = robot(grid)
    one.set_pose(ELSEWHERE, np.diag([0.01**2, 0.01**2, 0.01**2]))

    for moment in through_exchanged_objects(one, grid, 0, turned):
        assert apart(one.pose().mean, moment.pose)[0] < 0.5
