"""The map of a simulated drive: loops are closed, a moved robot is found, nothing is ever bent."""

import hashlib
import math
import os
import subprocess
import sys

import numpy as np
import pytest

from cairn.components.slam.mapping import Mapper
from cairn.planar.scans import Rays
from cairn.visual_map.observations import Observation
from tests.components.slam import box_room, courses
from tests.components.slam.map_errors import islands_of, map_errors
from tests.components.slam.recordings import SCANNERS, Leg, Recording, record

FARTHEST_M = 30.0


def mapped(recording: Recording) -> Mapper:
    mapper = Mapper(FARTHEST_M)
    for stamp, odometry, rays in zip(
        recording.stamps, recording.odometry, recording.rays, strict=True
    ):
        mapper.add_scan(stamp, odometry, rays)
    mapper.finish()
    return mapper


@pytest.mark.accuracy
@pytest.mark.slow
def test_a_tour_of_an_office_is_mapped_within_centimeters() -> None:
    recording = record(courses.shipped("office", 5.0), SCANNERS["UST-10LX"])
    mapper = mapped(recording)
    errors = map_errors(mapper, recording)
    assert mapper.closer.counts.accepted > 0
    assert errors.relation_m < 0.02
    assert errors.worst_m < 0.1
    assert errors.walls > 0.95


@pytest.mark.accuracy
@pytest.mark.slow
def test_people_who_walk_around_do_not_prevent_closures() -> None:
    recording = record(courses.shipped("hall", 5.0), SCANNERS["UST-10LX"])
    errors = map_errors(mapped(recording), recording)
    assert errors.worst_m < 0.1
    assert errors.walls > 0.95


@pytest.mark.accuracy
@pytest.mark.slow
def test_a_ring_of_equal_rooms_is_not_bent() -> None:
    recording = record(courses.ring(rooms=3), SCANNERS["UST-10LX"])
    assert not map_errors(mapped(recording), recording).is_broken


@pytest.mark.accuracy
@pytest.mark.slow
def test_a_robot_carried_to_other_rooms_is_joined_to_the_map() -> None:
    course = courses.shipped("office")
    stops = course.stops[: len(course.stops) // 2]
    carried = [(0.0, 0.0, 0.0), (2.0, 1.0, 0.8)]  # how the odometry moves meanwhile
    legs = [Leg(stops), *(Leg(stops[4:8], odometry_moved=moved) for moved in carried)]
    recording = record(course, SCANNERS["UST-10LX"], legs=legs)
    mapper = mapped(recording)
    assert [len(island.scans) for island in islands_of(mapper)] == [len(recording.stamps)]
    errors = map_errors(mapper, recording)
    assert errors.worst_m < 0.2
    assert errors.walls > 0.95


@pytest.mark.accuracy
@pytest.mark.slow
def test_an_unrecognized_place_stays_an_island_of_its_own() -> None:
    course = courses.shipped("office")
    first, second = [(1.0, 6.0), (3.0, 6.0), (2.0, 6.0)], [(17.5, 9.0), (17.5, 8.0), (18.0, 9.0)]
    recording = record(course, SCANNERS["URG-04LX"], legs=[Leg(first * 2), Leg(second)])
    mapper = mapped(recording)
    legs = np.array(recording.legs)
    islands = islands_of(mapper)
    assert len(islands) == 2
    assert [set(legs[island.scans]) for island in islands] == [{0}, {1}]
    assert not map_errors(mapper, recording).is_broken


def test_scans_of_a_moved_robot_belong_to_its_new_island() -> None:
    course = courses.shipped("office")
    legs = [Leg([(1.0, 6.0), (4.0, 6.0)]), Leg([(7.5, 3.0), (7.0, 2.0)])]
    recording = record(course, SCANNERS["UST-10LX"], legs=legs)
    mapper = mapped(recording)
    assert len(islands_of(mapper)) == 2
    carried = recording.legs.index(1)
    belongs = {k: n for n, island in enumerate(islands_of(mapper)) for k in island.scans.tolist()}
    assert belongs[carried - 1] != belongs[carried]
    assert len({belongs[k] for k in range(carried, len(recording.legs))}) == 1


_SCRIPT = """
import sys
from tests.components.slam.test_mapping import digest
print(digest())
"""


def digest() -> str:
    """Return a hash of the map of a short drive in the office."""
    stops = [(1.0, 6.0), (9.0, 6.0), (9.0, 9.0), (9.0, 6.0), (1.0, 6.0), (4.0, 6.0)]
    recording = record(courses.shipped("office"), SCANNERS["UST-10LX"], legs=[Leg(stops)])
    mapper = mapped(recording)
    assert mapper.closer.counts.accepted > 0
    return hashlib.sha256(mapper.poses().tobytes() + mapper.graph.poses.tobytes()).hexdigest()


@pytest.mark.accuracy
@pytest.mark.slow
def test_the_same_recording_gives_the_same_map_in_every_process() -> None:
    results = set()
    for threads in ("1", "4"):
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": threads,
            "OPENBLAS_NUM_THREADS": threads,
            "TBB_NUM_THREADS": threads,
        }
        done = subprocess.run(
            [sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=True,
            env=environment, timeout=300,
        )  # fmt: skip
        results.add(done.stdout.strip())
    assert len(results) == 1


def test_a_robot_is_recognized_where_it_was_just_before_it_was_carried_away() -> None:
    """The smaller room in which it was meanwhile stays an island: it is recognized nowhere."""
    mapper = Mapper(10.0)
    there_and_back = np.concatenate((np.arange(0.0, 3.5, 0.1), np.arange(3.5, 0.0, -0.1)))

    odometry = 0.0
    for ahead, size in (
        (np.arange(0.0, 2.0, 0.1), 1.0),
        (np.arange(0.0, 2.0, 0.1), 0.6),
        (np.tile(there_and_back, 3), 1.0),
    ):
        for k, x in enumerate(ahead.tolist()):
            rays = box_room.scan((x / size, 0.0, 0.0))
            rays = Rays(rays.starts, rays.angles, size * rays.ranges, rays.reach)
            odometry += x - float(ahead[k - 1]) if k else 0.0
            stamp = len(mapper.trajectory) * box_room.SECOND
            mapper.add_scan(stamp, (odometry, 0.0, 0.0), rays)
    mapper.finish()

    large, small = islands_of(mapper)
    assert small.scans.tolist() == list(range(20, 40))
    assert len(large.scans) == len(mapper.trajectory) - 20


@pytest.mark.parametrize(("jump_m", "islands"), [(0.0, 1), (2.0, 2)])
def test_a_robot_that_drives_on_while_scans_change_stays_on_the_map_unless_odometry_jumps(
    jump_m: float, islands: int
) -> None:
    """If odometry jumps as well, nothing says where the robot is."""
    mapper = Mapper(10.0)
    for k in range(40):
        size = 1.0 if k < 20 else 0.6
        rays = box_room.scan((0.1 * (k % 20) / size, 0.0, 0.0))
        rays = Rays(rays.starts, rays.angles, size * rays.ranges, rays.reach)
        x = 0.1 * k + (jump_m if k >= 20 else 0.0)
        mapper.add_scan(k * box_room.SECOND, (x, 0.0, 0.0), rays)
    assert len(islands_of(mapper)) == 2
    mapper.finish()

    assert len(islands_of(mapper)) == islands
    if not jump_m:
        assert mapper.poses()[:, 0] == pytest.approx(0.1 * np.arange(40), abs=0.1)


def test_a_map_of_nothing_is_finished() -> None:
    mapper = Mapper(10.0)
    mapper.finish()
    assert not islands_of(mapper)


def test_scans_follow_a_map_that_an_object_has_corrected() -> None:
    mapper = Mapper(10.0)
    nothing = np.full(box_room.ANGLES.size, np.inf)
    blind = Rays(np.zeros((nothing.size, 2)), box_room.ANGLES, nothing, 10.0)
    x = odometry = 0.0
    for k in range(180):
        is_blind = 6 <= k < 166  # meanwhile odometry overestimates the way ahead
        stamp = k * box_room.SECOND // 10
        rays = blind if is_blind else box_room.scan((x, 0.0, 0.0))
        mapper.add_scan(stamp, (odometry, 0.0, 0.0), rays)
        if k < 3 or k > 176:
            way, bearing = math.hypot(3.5 - x, 0.4), math.atan2(0.4, 3.5 - x)
            seen = Observation(1, way, bearing, 0.01**2, 0.003**2)
            mapper.add_observations(stamp, (odometry, 0.0, 0.0), [seen])
        step = (0.1 if k % 8 < 4 else -0.1) if is_blind else 0.05
        x += step
        odometry += 1.06 * step if is_blind and step > 0 else step
    assert odometry - x > 0.4

    assert mapper.pose == pytest.approx((x - 0.05, 0.0, 0.0), abs=0.05)
