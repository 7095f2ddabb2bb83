"""What a thing needs to be proposed as a landmark: evidence from simulated sightings."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from cairn import SECOND
from cairn.components.object_recognizer.hypotheses import (
    MOST_HYPOTHESES,
    Hypotheses,
    Hypothesis,
    ObjectSighting,
    Requirements,
    sighting_of,
)
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import RecognizedObject
from cairn.vision.features import no_features
from cairn.vision.object_model import ModelView, ObjectModel

NEEDS = Requirements(poses=5, visits=2, away_s=20.0)
PLACE = (3.0, 1.0)
VIEW = ModelView(10, 10, no_features(), np.zeros((10, 10), np.uint8))


def model(number: int) -> ObjectModel:
    return ObjectModel(number, f"hypothesis {number}", (0.4, 0.3), (VIEW,))


def seen_from(robot: Pose, place: tuple[float, float] = PLACE, sd: float = 0.03) -> ObjectSighting:
    return ObjectSighting(*place, sd**2 * np.eye(2), robot)


def around(count: int, spread: float = 1.0) -> list[Pose]:
    """Poses 2 m from the place, in directions over so many radians."""
    angles = np.linspace(-spread / 2, spread / 2, count).tolist()
    return [(PLACE[0] - 2 * math.cos(a), PLACE[1] - 2 * math.sin(a), a) for a in angles]


def add(hypotheses: Hypotheses, robots: Iterable[Pose], start_s: float, number: int = 1) -> None:
    for k, robot in enumerate(robots):
        hypotheses.recognized(round((start_s + k) * SECOND), [(number, seen_from(robot))])


@pytest.fixture
def hypotheses() -> Hypotheses:
    found = Hypotheses(NEEDS)
    found.add(model(1))
    return found


def test_thing_seen_on_two_visits_from_several_poses_is_proposed(hypotheses: Hypotheses) -> None:
    add(hypotheses, around(6), 0)
    assert hypotheses.take_proposed() == []  # one visit

    add(hypotheses, around(1), 100)

    (proposed,) = hypotheses.take_proposed()
    assert proposed.seen == 7
    assert proposed.place()[0] == pytest.approx(PLACE)
    assert len(hypotheses) == 0


def test_pause_shorter_than_a_visit_is_none(hypotheses: Hypotheses) -> None:
    add(hypotheses, around(6), 0)
    add(hypotheses, around(1), 20)

    assert hypotheses.take_proposed() == []


@pytest.mark.parametrize(
    "robots",
    [
        [around(1)[0]] * 8,
        around(8, spread=0.1),
    ],
    ids=["one pose", "nearly one pose"],
)
def test_thing_seen_from_one_place_is_not_proposed(
    hypotheses: Hypotheses, robots: list[Pose]
) -> None:
    add(hypotheses, robots, 0)
    add(hypotheses, robots, 100)

    assert hypotheses.take_proposed() == []


def test_thing_approached_straight_is_proposed(hypotheses: Hypotheses) -> None:
    robots = [(PLACE[0] - away, PLACE[1], 0.0) for away in (3.0, 2.7, 2.4, 2.1, 1.8)]
    add(hypotheses, robots, 0)
    add(hypotheses, robots[:1], 100)

    assert len(hypotheses.take_proposed()) == 1


def test_thing_that_moves_is_forgotten(hypotheses: Hypotheses) -> None:
    add(hypotheses, around(6), 0)

    moved = seen_from(around(1)[0], (PLACE[0], PLACE[1] + 0.6))
    assert hypotheses.recognized(100 * SECOND, [(1, moved)])

    assert 1 not in hypotheses


def test_thing_that_is_visible_twice_is_forgotten(hypotheses: Hypotheses) -> None:
    twin = seen_from(around(1)[0], (PLACE[0], PLACE[1] + 1.0))

    assert hypotheses.recognized(0, [(1, seen_from(around(1)[0])), (1, twin)])

    assert 1 not in hypotheses


def test_single_error_of_range_does_not_count(hypotheses: Hypotheses) -> None:
    add(hypotheses, around(6), 0)
    off = seen_from(around(1)[0], (PLACE[0] + 0.2, PLACE[1]))
    assert not hypotheses.recognized(50 * SECOND, [(1, off)])
    add(hypotheses, around(1), 100)

    (proposed,) = hypotheses.take_proposed()
    assert proposed.seen == 7
    assert proposed.place()[0] == pytest.approx(PLACE)


def test_hypotheses_seen_least_are_forgotten_first(hypotheses: Hypotheses) -> None:
    add(hypotheses, around(3), 0)
    for number in range(2, 3 * MOST_HYPOTHESES):
        hypotheses.add(model(number))

    assert len(hypotheses) == MOST_HYPOTHESES
    assert 1 in hypotheses


def test_covariance_of_the_place_shrinks_with_sightings() -> None:
    one = Hypothesis(model(1))
    spreads = []
    for k, robot in enumerate(around(10, spread=2.5)):
        one.add(k, seen_from(robot, sd=0.1), 20.0)
        spreads.append(float(np.trace(one.place()[1])))

    assert spreads == sorted(spreads, reverse=True)
    assert spreads[0] == pytest.approx(2 * (0.1**2 + 0.02**2))
    assert spreads[-1] == pytest.approx(2 * (0.1**2 / 10 + 0.02**2))


def test_place_of_an_observation_has_the_errors_of_pose_and_range() -> None:
    observed = RecognizedObject(
        object_id=1, range=2.0, bearing=math.pi / 2, covariance=np.array([0.04, 0, 0, 1e-4])
    )
    pose_covariance = np.diag([0.01, 0.02, 0.0025])

    found = sighting_of(observed, (1.0, 2.0, 0.0), pose_covariance)

    assert (found.x, found.y) == pytest.approx((1.0, 4.0))
    across = 0.01 + 4 * 0.0025 + 4 * 1e-4
    assert np.diag(found.covariance) == pytest.approx([across, 0.02 + 0.04], abs=1e-5)
