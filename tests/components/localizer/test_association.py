"""Pictures that look alike are told apart by where they hang, or not told at all."""

import math

import numpy as np

from cairn.components.localizer.observations import Landmark, Observation, associate
from cairn.components.localizer.particle_set import PoseEstimate

AT_ORIGIN = PoseEstimate((0.0, 0.0, 0.0), np.diag([0.0025, 0.0025, 0.0004]))
NORTH, EAST = Landmark(1, 0.0, 3.0), Landmark(2, 3.0, 0.0)
BOTH = {1: NORTH, 2: EAST}


def seen(object_id: int, range_m: float, bearing: float, *alternatives: int) -> Observation:
    return Observation(object_id, range_m, bearing, 0.01, 0.0004, alternatives)


def test_a_sighting_that_is_of_one_object_stays_as_it_is() -> None:
    moved = seen(1, 1.0, 1.0)

    assert associate([moved], AT_ORIGIN, BOTH) == [moved]


def test_of_two_objects_that_look_alike_it_is_the_one_that_stands_there() -> None:
    [found] = associate([seen(1, 3.0, 0.0, 2)], AT_ORIGIN, BOTH)

    assert found.object_id == 2
    assert found.alternatives == ()


def test_one_of_two_that_look_alike_where_neither_stands_is_left_out() -> None:
    assert associate([seen(1, 1.5, -1.0, 2)], AT_ORIGIN, BOTH) == []


def test_two_that_look_alike_and_hang_together_are_left_out() -> None:
    together = {1: Landmark(1, 3.0, 0.1), 2: Landmark(2, 3.0, -0.1)}

    assert associate([seen(1, 3.0, 0.0, 2)], AT_ORIGIN, together) == []


def test_a_robot_that_is_not_located_leaves_out_what_is_ambiguous() -> None:
    sure = seen(2, 3.0, 0.0)

    assert associate([seen(1, 3.0, math.pi / 2, 2), sure], None, BOTH) == [sure]


def test_of_two_instances_of_one_object_the_mapped_one_counts() -> None:
    other, mapped = seen(2, 2.0, 0.8), seen(2, 3.05, 0.0)

    assert associate([other, mapped], AT_ORIGIN, BOTH) == [mapped]


def test_two_instances_of_an_object_that_stands_at_neither_place_are_left_out() -> None:
    assert associate([seen(2, 2.0, 0.8), seen(2, 1.0, -0.5)], AT_ORIGIN, BOTH) == []


def test_an_alternative_that_was_removed_from_the_map_is_none() -> None:
    gone = {1: NORTH, 2: Landmark(2, 3.0, 0.0, live=False)}

    assert associate([seen(1, 3.0, 0.0, 2)], AT_ORIGIN, gone) == []
