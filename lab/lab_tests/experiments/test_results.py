"""Methods are judged by the ground truth, not by what their maps contain."""

import math

import pytest

from cairn_lab.experiments.results import (
    MethodResult,
    judge_method,
    judge_run,
    viewpoint_stamps,
)
from cairn_lab.experiments.series import (
    MethodSeries,
    ObservedObject,
    RecordedLandmark,
    WorldSeries,
)
from lab_tests.experiments.recorded import (
    method_series,
    registration,
    removal,
    world_series,
)

OLD, NEW, OTHER = (2.0, 0.0), (2.0, 3.0), (-2.0, 0.0)
MOVED_AT = 10.0
BEFORE, AFTER = (0.0, {1: OLD, 2: OTHER}), (MOVED_AT, {1: NEW, 2: OTHER})


def observed_at(
    position: tuple[float, float], *stamps: float, object_id: int = 1
) -> list[ObservedObject]:
    """Observations of a position from the origin."""
    range_m, bearing = math.hypot(*position), math.atan2(position[1], position[0])
    return [ObservedObject(stamp, object_id, range_m, bearing) for stamp in stamps]


def judged(series: MethodSeries, truth: WorldSeries) -> MethodResult:
    return judge_method("ours", series, truth, MOVED_AT)


def test_noticed_move_is_reported_with_its_observations() -> None:
    observations = observed_at(OLD, 5.0) + observed_at(NEW, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0)
    truth = world_series(BEFORE, AFTER, observations=observations)
    series = method_series(changes=[removal(13.0, 1, OLD), registration(15.0, 1, (2.0, 3.1))])

    (move,) = judged(series, truth).moves

    assert (move.moved_at, move.observations) == (MOVED_AT, 6)
    assert move.distance == pytest.approx(3.0)
    assert move.neighbor_distance == pytest.approx(5.0)
    assert (move.removed_at, move.observations_to_remove) == (13.0, 3)
    assert (move.registered_at, move.observations_to_register) == (15.0, 5)
    assert move.registration_error == pytest.approx(0.1)
    assert move.noticed


def test_removal_before_the_move_does_not_notice_it() -> None:
    truth = world_series(BEFORE, AFTER, observations=observed_at(NEW, 11.0))

    result = judged(method_series(changes=[removal(9.0, 1, OLD)]), truth)

    assert not result.moves[0].noticed
    assert len(result.false_removals) == 1


def test_registration_notices_the_move_of_a_landmark_removed_too_early() -> None:
    truth = world_series(BEFORE, AFTER, observations=observed_at(NEW, 11.0))
    series = method_series(changes=[removal(9.0, 1, OLD), registration(12.0, 1, NEW)])

    (move,) = judged(series, truth).moves

    assert move.noticed
    assert move.removed_at is None
    elsewhere = method_series(changes=[removal(9.0, 1, OLD), registration(12.0, 1, OTHER)])
    assert not judged(elsewhere, truth).moves[0].noticed


def test_removal_is_false_if_the_object_stands_there() -> None:
    truth = world_series(BEFORE, AFTER)
    series = method_series(
        changes=[removal(12.0, 1, OLD), removal(12.0, 2, OTHER), removal(15.0, 1, NEW)]
    )

    result = judged(series, truth)

    assert result.removals == 3
    assert [one.split(":")[0] for one in result.false_removals] == [
        "object 2 at 12.0 s",
        "object 1 at 15.0 s",
    ]


def test_half_of_a_short_move_separates_the_old_from_the_new_position() -> None:
    near = (2.0, 0.25)
    truth = world_series(BEFORE, (MOVED_AT, {1: near, 2: OTHER}))

    assert not judged(method_series(changes=[removal(12.0, 1, OLD)]), truth).false_removals
    assert judged(method_series(changes=[removal(12.0, 1, (2.0, 0.2))]), truth).false_removals


def test_registration_far_from_the_true_position_is_false() -> None:
    truth = world_series(BEFORE, AFTER)
    series = method_series(
        changes=[registration(12.0, 1, (2.0, 3.2)), registration(13.0, 2, (-2.0, 0.4))]
    )

    result = judged(series, truth)

    assert result.registrations == 2
    assert len(result.false_registrations) == 1
    assert result.false_registrations[0].startswith("object 2 ")


def test_map_at_the_end_is_compared_with_the_truth() -> None:
    truth = world_series(BEFORE, AFTER)
    landmarks = [
        RecordedLandmark(0.0, 1, OLD, True, 0.5),
        RecordedLandmark(0.0, 2, OTHER, True, 0.5),
        RecordedLandmark(12.0, 1, OLD, False, 0.1),
        RecordedLandmark(15.0, 2, (-2.0, 0.2), True, 0.9),
    ]

    result = judged(method_series(landmarks=landmarks), truth)

    assert result.map_error == pytest.approx(0.2)  # landmarks that are not live are left out
    assert result.missing == [1]


def test_observations_of_another_object_are_false_matches() -> None:
    observations = [
        *observed_at(NEW, 11.0),
        *observed_at(OTHER, 12.0, object_id=1),
        *observed_at((5.0, 5.0), 13.0),
    ]
    truth = world_series(BEFORE, AFTER, observations=observations)

    result = judge_run(3, truth, MOVED_AT)

    assert (result.seed, result.observations, result.false_matches) == (3, 3, 2)
    assert result.coverage == {1: (0, 1), 2: (0, 0)}


def test_viewpoints_differ_in_position_or_heading() -> None:
    observed = [(1.0, (0.0, 0.0, 0.0)), (2.0, (0.1, 0.0, 0.0)), (3.0, (0.2, 0.0, 0.0))]
    observed += [(4.0, (0.2, 0.0, 0.1)), (5.0, (0.2, 0.0, 0.3))]

    assert viewpoint_stamps(observed) == [1.0, 3.0, 5.0]


def test_errors_are_reported_before_and_after_the_change() -> None:
    result = judged(method_series(off=0.5), world_series(BEFORE, AFTER))

    assert result.rms_before == pytest.approx(0.5)
    assert result.rms_after == pytest.approx(0.5)
    assert result.lost_after == 0.0


def test_robot_without_an_estimate_is_lost() -> None:
    assert judged(
        method_series(until=15.0), world_series(BEFORE, AFTER)
    ).lost_after == pytest.approx(0.5)
    assert judged(method_series(off=1.2), world_series(BEFORE, AFTER)).lost_after == 1.0


def test_kidnapped_robot_is_relocalized_when_its_estimate_is_near_the_truth() -> None:
    poses = [(0.0, 0.0, 0.0)] * 100 + [(5.0, 0.0, 0.0)] * 50 + [(0.1, 0.0, 0.0)] * 51
    truth = world_series(BEFORE, poses=poses)

    assert judge_run(1, truth, MOVED_AT).kidnapped_at == pytest.approx(10.0)
    relocalized = judged(method_series(), truth).relocalized_s
    assert relocalized == pytest.approx(5.0, abs=0.11)
    assert judged(method_series(off=9.0), truth).relocalized_s is None
    assert judged(method_series(), world_series(BEFORE)).relocalized_s is None
