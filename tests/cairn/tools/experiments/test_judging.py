"""Which moves were noticed, and what was wrong: judged by the truth, not by what the map says."""

import math

import pytest

from cairn.tools.experiments.judging import PairResult, judged_pair, judged_world, views
from cairn.tools.experiments.series import Mapped, PairSeries, Sighting, WorldSeries
from tests.cairn.tools.experiments.written import pair, registered, removed, world

OLD, NEW, OTHER = (2.0, 0.0), (2.0, 3.0), (-2.0, 0.0)
MOVED_AT = 10.0
BEFORE, AFTER = (0.0, {1: OLD, 2: OTHER}), (MOVED_AT, {1: NEW, 2: OTHER})


def seen_at(place: tuple[float, float], *stamps: float, name: int = 1) -> list[Sighting]:
    """From the origin."""
    reach, bearing = math.hypot(*place), math.atan2(place[1], place[0])
    return [Sighting(stamp, name, reach, bearing) for stamp in stamps]


def judged(made: PairSeries, truth: WorldSeries) -> PairResult:
    return judged_pair("ours", made, truth, MOVED_AT)


def test_a_move_that_was_noticed_is_told_with_what_it_took() -> None:
    sightings = seen_at(OLD, 5.0) + seen_at(NEW, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0)
    truth = world(BEFORE, AFTER, sightings=sightings)
    made = pair(changes=[removed(13.0, 1, OLD), registered(15.0, 1, (2.0, 3.1))])

    (move,) = judged(made, truth).moves

    assert (move.moved_at, move.sightings) == (MOVED_AT, 6)
    assert move.way == pytest.approx(3.0)
    assert move.beside == pytest.approx(5.0)
    assert (move.removed_at, move.sightings_to_remove) == (13.0, 3)
    assert (move.registered_at, move.sightings_to_register) == (15.0, 5)
    assert move.registered_error == pytest.approx(0.1)
    assert move.noticed


def test_a_removal_before_the_move_does_not_notice_it() -> None:
    truth = world(BEFORE, AFTER, sightings=seen_at(NEW, 11.0))

    result = judged(pair(changes=[removed(9.0, 1, OLD)]), truth)

    assert not result.moves[0].noticed
    assert len(result.false_removals) == 1


def test_who_was_removed_too_early_notices_the_move_by_registering() -> None:
    truth = world(BEFORE, AFTER, sightings=seen_at(NEW, 11.0))
    made = pair(changes=[removed(9.0, 1, OLD), registered(12.0, 1, NEW)])

    (move,) = judged(made, truth).moves

    assert move.noticed
    assert move.removed_at is None
    elsewhere = pair(changes=[removed(9.0, 1, OLD), registered(12.0, 1, OTHER)])
    assert not judged(elsewhere, truth).moves[0].noticed


def test_removing_what_stands_there_is_false_and_what_was_moved_is_not() -> None:
    truth = world(BEFORE, AFTER)
    made = pair(changes=[removed(12.0, 1, OLD), removed(12.0, 2, OTHER), removed(15.0, 1, NEW)])

    result = judged(made, truth)

    assert result.removals == 3
    assert [told.split(":")[0] for told in result.false_removals] == [
        "object 2 at 12.0 s",
        "object 1 at 15.0 s",
    ]


def test_of_a_short_move_half_of_the_way_tells_old_from_new() -> None:
    near = (2.0, 0.25)
    truth = world(BEFORE, (MOVED_AT, {1: near, 2: OTHER}))

    assert not judged(pair(changes=[removed(12.0, 1, OLD)]), truth).false_removals
    assert judged(pair(changes=[removed(12.0, 1, (2.0, 0.2))]), truth).false_removals


def test_a_registration_is_false_if_it_is_far_off() -> None:
    truth = world(BEFORE, AFTER)
    made = pair(changes=[registered(12.0, 1, (2.0, 3.2)), registered(13.0, 2, (-2.0, 0.4))])

    result = judged(made, truth)

    assert result.registrations == 2
    assert len(result.false_registrations) == 1
    assert result.false_registrations[0].startswith("object 2 ")


def test_the_map_in_the_end_is_compared_with_the_truth() -> None:
    truth = world(BEFORE, AFTER)
    mapped = [
        Mapped(0.0, 1, OLD, True, 0.5),
        Mapped(0.0, 2, OTHER, True, 0.5),
        Mapped(12.0, 1, OLD, False, 0.1),
        Mapped(15.0, 2, (-2.0, 0.2), True, 0.9),
    ]

    result = judged(pair(mapped=mapped), truth)

    assert result.map_error == pytest.approx(0.2)  # what is not live is not in it
    assert result.missing == [1]


def test_sightings_that_are_of_another_object_count_for_nobody() -> None:
    sightings = [*seen_at(NEW, 11.0), *seen_at(OTHER, 12.0, name=1), *seen_at((5.0, 5.0), 13.0)]
    truth = world(BEFORE, AFTER, sightings=sightings)

    result = judged_world(3, truth, MOVED_AT)

    assert (result.seed, result.sightings, result.mistaken) == (3, 3, 2)
    assert result.coverage == {1: (0, 1), 2: (0, 0)}


def test_views_are_sightings_from_another_place_or_in_another_direction() -> None:
    seen = [(1.0, (0.0, 0.0, 0.0)), (2.0, (0.1, 0.0, 0.0)), (3.0, (0.2, 0.0, 0.0))]
    seen += [(4.0, (0.2, 0.0, 0.1)), (5.0, (0.2, 0.0, 0.3))]

    assert views(seen) == [1.0, 3.0, 5.0]


def test_errors_are_told_before_and_after_the_change() -> None:
    result = judged(pair(off=0.5), world(BEFORE, AFTER))

    assert result.rms_before == pytest.approx(0.5)
    assert result.rms_after == pytest.approx(0.5)
    assert result.lost_after == 0.0


def test_a_robot_that_tells_no_pose_is_lost() -> None:
    assert judged(pair(until=15.0), world(BEFORE, AFTER)).lost_after == pytest.approx(0.5)
    assert judged(pair(off=1.2), world(BEFORE, AFTER)).lost_after == 1.0


def test_a_robot_that_is_carried_off_is_found_when_it_tells_the_truth() -> None:
    poses = [(0.0, 0.0, 0.0)] * 100 + [(5.0, 0.0, 0.0)] * 50 + [(0.1, 0.0, 0.0)] * 51
    truth = world(BEFORE, poses=poses)

    assert judged_world(1, truth, MOVED_AT).carried_at == pytest.approx(10.0)
    found = judged(pair(), truth).found_s
    assert found == pytest.approx(5.0, abs=0.11)
    assert judged(pair(off=9.0), truth).found_s is None
    assert judged(pair(), world(BEFORE)).found_s is None
