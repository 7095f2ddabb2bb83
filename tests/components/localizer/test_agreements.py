"""Until when a lost robot was not lost: objects at two places must have agreed since."""

import math

from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.relocalization import ConfirmationHistory

HERE, BESIDE, FAR = Landmark(1, 0.0, 0.0), Landmark(2, 0.4, 0.0), Landmark(3, 4.0, 0.0)
MAP = {mark.object_id: mark for mark in (HERE, BESIDE, FAR)}


def until(*agreed: tuple[float, int]) -> float:
    it = ConfirmationHistory()
    for stamp, object_id in agreed:
        it.add(stamp, [object_id])
    it.on_pose_replaced(MAP)
    return it.confirmed_until


def test_two_places_agreed_since_the_earlier_of_their_newest_agreements() -> None:
    assert until((1.0, 3), (2.0, 1), (3.0, 3)) == 2.0


def test_one_object_alone_may_agree_by_chance() -> None:
    assert until((1.0, 1), (2.0, 1)) == -math.inf


def test_objects_that_stand_together_are_one_place() -> None:
    assert until((1.0, 3), (2.0, 1), (3.0, 2)) == 1.0
    assert until((2.0, 1), (3.0, 2)) == -math.inf


def test_what_agreed_with_another_pose_does_not_count_together() -> None:
    it = ConfirmationHistory()
    for stamp, object_id in ((1.0, 1), (2.0, 3)):
        it.add(stamp, [object_id])
    it.on_pose_replaced(MAP)
    it.add(3.0, [1])
    it.on_pose_replaced(MAP)
    it.add(4.0, [3])
    it.on_pose_replaced(MAP)

    assert it.confirmed_until == 1.0


def test_an_object_that_left_the_map_tells_nothing() -> None:
    assert until((1.0, 3), (2.0, 9)) == -math.inf
