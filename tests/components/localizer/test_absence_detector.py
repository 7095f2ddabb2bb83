"""The absence detector: objects in view that are not recognized, unless something hides them."""

import math

import numpy as np
import pytest

from cairn.components.localizer.absence_detector import (
    AbsenceDetector,
    expected,
    is_visible,
)
from cairn.components.localizer.observations import CameraView, Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.visual_map.observations import Observation

AHEAD = CameraView(-math.radians(30), math.radians(30), 0.4, 5.0)
SURE = PoseEstimate((0.0, 0.0, 0.0), np.diag([0.0004, 0.0004, 0.0001]))
POSTER = Landmark(1, 3.0, 0.0)
ELSEWHERE = Landmark(2, 2.0, 0.8)
WALL = np.column_stack((np.full(61, 3.0), np.linspace(-1.5, 1.5, 61)))
NO_MISSES = np.empty((0, 2))


def new_detector(points: np.ndarray = WALL, scanned: float = 10.0) -> AbsenceDetector:
    it = AbsenceDetector()
    it.add_scan(scanned, points, NO_MISSES, (0.0, 0.0, 0.0))
    it.add_agreeing(10.0, [2])
    return it


def missed(
    it: AbsenceDetector, *seen: Observation, stamp: float = 10.0, poster: Landmark = POSTER
) -> list[int]:
    landmarks = {1: poster, 2: ELSEWHERE}
    found = it.missing(
        stamp,
        AHEAD,
        [Observation(2, 2.2, 0.4, 0.01, 0.001), *seen],
        landmarks,
        SURE,
        (0.0, 0.0, 0.0),
    )
    return [landmark.object_id for landmark, _, _ in found]


def test_unrecognized_object_in_view_is_missing() -> None:
    assert missed(new_detector()) == [1]


def test_recognized_object_is_not_missing() -> None:
    assert missed(new_detector(), Observation(1, 3.0, 0.0, 0.01, 0.001)) == []


def test_object_recognized_as_an_alternative_is_not_missing() -> None:
    assert missed(new_detector(), Observation(5, 3.0, 0.0, 0.01, 0.001, (1,))) == []


def test_object_removed_from_the_map_is_not_missing() -> None:
    assert missed(new_detector(), poster=Landmark(1, 3.0, 0.0, live=False)) == []


def test_person_in_front_hides_the_object() -> None:
    person = np.column_stack((np.full(11, 1.5), np.linspace(-0.2, 0.2, 11)))

    assert missed(new_detector(np.concatenate((WALL, person)))) == []


def test_object_without_a_beam_in_its_direction_is_not_missing() -> None:
    assert missed(new_detector(WALL[:20])) == []
    assert missed(AbsenceDetector()) == []


def test_nothing_is_missing_while_the_camera_recognizes_nothing() -> None:
    assert missed(new_detector(scanned=40.0), stamp=40.0) == [1]
    assert missed(new_detector(scanned=41.0), stamp=41.0) == []


def test_nothing_is_missing_without_recent_scans() -> None:
    assert missed(new_detector(scanned=9.1)) == [1]
    assert missed(new_detector(scanned=8.9)) == []


def test_many_missing_objects_indicate_a_failing_camera() -> None:
    it = new_detector()
    dark = {1: POSTER, 3: Landmark(3, 2.9, 0.6)}

    it.add_scan(14.0, WALL, NO_MISSES, (0.0, 0.0, 0.0))
    at_first = it.missing(11.0, AHEAD, [], dark, SURE, (0.0, 0.0, 0.0))
    then = it.missing(14.0, AHEAD, [], dark, SURE, (0.0, 0.0, 0.0))
    it.add_agreeing(15.0, [2])
    with_another = it.missing(15.0, AHEAD, [], dark, SURE, (0.0, 0.0, 0.0))

    # The camera saw well a moment ago: for a moment these two may have been taken away together.
    assert [landmark.object_id for landmark, _, _ in at_first] == [1, 3]
    assert then == []
    assert [landmark.object_id for landmark, _, _ in with_another] == [1, 3]


def test_scan_is_transformed_to_the_current_pose() -> None:
    """A person 1 m ahead; the robot has gone by."""
    it = new_detector(np.array([[1.0, 0.0], [3.0, 0.0]]))
    past = PoseEstimate((1.5, 0.0, 0.0), SURE.covariance)

    found = it.missing(10.0, AHEAD, [], {1: POSTER, 2: ELSEWHERE}, past, (1.5, 0.0, 0.0))

    assert [landmark.object_id for landmark, _, _ in found] == [1]


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.0), (4.9, 0.0), (2.0, 1.1), (2.0, -1.1), (-3.0, 0.0)])
def test_object_at_the_edge_of_the_view_is_not_expected(x: float, y: float) -> None:
    assert expected(SURE, Landmark(1, x, y), AHEAD) is None


def test_uncertain_heading_narrows_the_expected_view() -> None:
    unsure = PoseEstimate((0.0, 0.0, 0.0), np.diag([0.0004, 0.0004, 0.04]))

    assert expected(SURE, Landmark(1, 3.0, 0.6), AHEAD) is not None
    assert expected(unsure, Landmark(1, 3.0, 0.6), AHEAD) is None


def test_beam_without_a_hit_means_a_free_line_of_sight() -> None:
    assert is_visible(np.empty((0, 2)), np.array([[4.0, 0.01]]), 3.0, 0.0)
    assert not is_visible(np.empty((0, 2)), np.array([[2.0, 0.01]]), 3.0, 0.0)
