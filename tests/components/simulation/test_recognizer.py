"""Objects are recognized if a camera can see them, as often as configured."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from cairn import Mount
from cairn.components.simulation.layout import SURFACES
from cairn.components.simulation.recognizer import (
    SimulatedRecognition,
    SimulatedRecognizerConfig,
    recognize,
)
from cairn.components.simulation.world_file import Surface
from cairn.components.simulation.world_tracker import RayTargets, RecognizableObject
from cairn.planar.poses import Pose

EYE = SimulatedRecognizerConfig(
    field_of_view=math.radians(60),
    nearest=0.4,
    farthest=5.0,
    facing=math.radians(70),
    range_sd=0.01,
    range_sd_m2=0.01,
    bearing_sd=0.02,
    detection_probability=1.0,
    confusion_probability=0.0,
)
ROBOT: Pose = (0.0, 0.0, 0.0)
NOWHERE = RayTargets(np.zeros((0, 4)), np.zeros(0, np.uint8), np.zeros((0, 3)))


def facing(x: float, y: float, object_id: int = 1, offset: float = 0.0) -> RecognizableObject:
    """An object that faces the origin, or is turned from it by an angle [rad]."""
    return RecognizableObject(object_id, (x, y, math.atan2(-y, -x) + offset))


def observe(
    objects: Sequence[RecognizableObject],
    around: RayTargets = NOWHERE,
    eye: SimulatedRecognizerConfig = EYE,
    mount: Pose = (0.0, 0.0, 0.0),
    seed: int = 0,
) -> list[SimulatedRecognition]:
    x, y, theta = mount
    eye = eye.model_copy(update={"mount": Mount(x=x, y=y, theta=theta)})
    return recognize(eye, ROBOT, objects, around, np.random.default_rng(seed))


def segment_at(x: float, surface: Surface = "plain") -> RayTargets:
    """A segment across the view."""
    number = SURFACES[surface]
    return RayTargets(np.array([[x, -1.0, x, 1.0]]), np.array([number], np.uint8), np.zeros((0, 3)))


@pytest.mark.parametrize(
    ("recognizable", "expected"),
    [
        (facing(2, 0), True),
        (facing(2 * math.cos(0.5), 2 * math.sin(0.5)), True),
        (facing(2 * math.cos(0.55), 2 * math.sin(0.55)), False),
        (facing(-2, 0), False),
        (facing(0.3, 0), False),
        (facing(5.1, 0), False),
        (facing(2, 0, offset=math.radians(69)), True),
        (facing(2, 0, offset=math.radians(-71)), False),
        (facing(2, 0, offset=math.pi), False),
    ],
)
def test_object_is_recognized_in_view_in_range_and_from_its_front(
    recognizable: RecognizableObject, expected: bool
) -> None:
    assert bool(observe([recognizable])) == expected


def test_object_is_hidden_by_obstacles_but_not_by_its_own_wall() -> None:
    assert not observe([facing(2, 0)], segment_at(1.0))
    assert observe([facing(2, 0)], segment_at(2.0))
    assert observe([facing(2, 0)], segment_at(3.0))
    assert observe([facing(2, 0)], segment_at(1.0, "glass"))
    person = RayTargets(np.zeros((0, 4)), np.zeros(0, np.uint8), np.array([[1.0, 0.0, 0.25]]))
    assert not observe([facing(2, 0)], person)


def test_range_and_bearing_are_relative_to_the_base_for_each_camera_mount() -> None:
    (one,) = observe([facing(3, 0.5)], mount=(0.5, 0.2, 0.4))

    assert one.range_m == pytest.approx(math.hypot(3, 0.5), abs=4 * one.range_sd)
    assert one.bearing == pytest.approx(math.atan2(0.5, 3), abs=4 * one.bearing_sd)


def test_errors_have_the_configured_deviation() -> None:
    found = [observe([facing(2, 0)], seed=seed)[0] for seed in range(800)]

    assert found[0].range_sd == pytest.approx(0.05)
    assert np.std([(one.range_m - 2) / one.range_sd for one in found]) == pytest.approx(1, abs=0.1)
    assert np.std([one.bearing / one.bearing_sd for one in found]) == pytest.approx(1, abs=0.1)


def test_objects_are_missed_and_confused_as_often_as_configured() -> None:
    eye = EYE.model_copy(update={"detection_probability": 0.7, "confusion_probability": 0.2})
    objects = [facing(2, 0, 1), facing(-2, 0, 2), facing(-2, 1, 3)]
    random = np.random.default_rng(0)
    found = [recognize(eye, ROBOT, objects, NOWHERE, random) for _ in range(2000)]
    ids = [one.object_id for sighting in found for one in sighting]

    assert len(ids) / 2000 == pytest.approx(0.7, abs=0.04)
    assert sum(one != 1 for one in ids) / len(ids) == pytest.approx(0.2, abs=0.04)
    assert ids.count(2) == pytest.approx(ids.count(3), rel=0.35)


def test_random_numbers_of_objects_are_independent() -> None:
    eye = EYE.model_copy(update={"confusion_probability": 0.5})
    other = facing(3, 0.2, 2)
    for seed in range(20):
        with_it = observe([facing(2, -0.5, 1), other], eye=eye, seed=seed)[-1]
        without = observe([facing(-2, -0.5, 1), other], eye=eye, seed=seed)[-1]
        assert with_it == without
