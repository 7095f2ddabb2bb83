"""Taught objects before the camera are told of with where they are, and where any could be seen."""

import logging
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import remove_model, teach
from tests.components.object_recognizer.conftest import Robot
from tests.components.object_recognizer.scenes import SIZE, Thing, info, picture_of

pytestmark = pytest.mark.images


Begin = Callable[..., Robot]


def test_an_object_is_told_with_number_place_corners_and_the_image_s_stamp(robot: Begin) -> None:
    it = robot().know()

    told = it.see([Thing(1, x=0.2, z=1.5)])

    assert told.header.frame_id == "base_link"
    assert told.header.stamp.sec + told.header.stamp.nanosec / 1e9 == pytest.approx(it.now_s)
    (one,) = told.objects
    assert one.object_id == 1
    assert one.range == pytest.approx(math.hypot(0.2, 1.5), abs=0.03)
    assert one.bearing == pytest.approx(math.atan2(-0.2, 1.5), abs=0.01)
    assert one.inliers > 30
    assert list(one.alternatives) == []
    expected = [
        (320 + 500 * (0.2 + across * 0.2) / 1.5, 240 + 500 * down * 0.15 / 1.5)
        for across, down in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    assert np.abs(one.corners.reshape(4, 2) - expected).max() < 2


@pytest.mark.parametrize("stereo", [True, False])
@pytest.mark.parametrize("seed", [1, 3])
def test_errors_are_as_the_covariance_says(robot: Begin, stereo: bool, seed: int) -> None:
    it = robot(stereo=stereo).know()
    random = np.random.default_rng(seed)
    nis = []
    for _ in range(8):
        thing = Thing(
            seed, random.uniform(-0.3, 0.3), random.uniform(1.0, 2.2), random.uniform(-0.5, 0.5)
        )
        for one in it.see([thing]).objects:
            off = np.array(
                [
                    one.range - math.hypot(thing.x, thing.z),
                    one.bearing - math.atan2(-thing.x, thing.z),
                ]
            )
            nis.append(float(off @ np.linalg.solve(one.covariance.reshape(2, 2), off)))
    if seed == 3 and not stereo:
        assert nis == []  # neither its size is known nor is there stereo
        return
    assert len(nis) >= 7
    assert np.mean(nis) < 4.0  # 2 if it is exact, less if it is careful
    assert max(nis) < 13.8


def test_several_objects_and_two_of_a_kind_are_all_told(robot: Begin) -> None:
    it = robot().know()

    told = it.see([Thing(1, -0.5, 1.6), Thing(1, 0.0, 1.6), Thing(2, 0.5, 1.6)])

    assert [one.object_id for one in sorted(told.objects, key=lambda one: -one.bearing)] == [
        1,
        1,
        2,
    ]


def test_what_was_not_taught_is_not_recognized(robot: Begin) -> None:
    told = robot().know().see([Thing(77, 0.0, 1.2), Thing(78, 0.5, 1.6)])

    assert told.objects == ()
    assert told.view_left > told.view_right


def test_places_are_from_the_base_wherever_the_camera_sits(robot: Begin) -> None:
    it = robot(mount={"x": 0.3, "y": -0.1, "theta": math.pi / 2}).know()

    told = it.see([Thing(1, x=0.2, z=1.5)])

    # Ahead of the camera is to the robot's left, right of it ahead of the robot.
    (one,) = told.objects
    x, y = 0.3 + 0.2, -0.1 + 1.5
    assert one.range == pytest.approx(math.hypot(x, y), abs=0.03)
    assert one.bearing == pytest.approx(math.atan2(y, x), abs=0.01)
    assert told.view_right < math.pi / 2 < told.view_left


def test_the_view_is_where_an_object_is_whole_in_the_image(robot: Begin) -> None:
    told = robot(nearest=0.5, farthest=4.0).know().see([])

    half = math.atan(320 / 500)
    assert 0.7 * half < told.view_left < half
    assert -half < told.view_right < -0.7 * half
    assert 0.5 < told.nearest < told.farthest < 4.0


@pytest.mark.parametrize("limits", [{"nearest": 1.6}, {"nearest": 0.2, "farthest": 1.4}])
def test_what_is_too_near_or_too_far_is_not_told(robot: Begin, limits: dict[str, float]) -> None:
    assert robot(**limits).know().see([Thing(1, 0.0, 1.5)]).objects == ()


def test_what_is_recognized_but_not_told_of_is_not_missed(robot: Begin) -> None:
    told = robot(least_inliers=1000).know().see([Thing(1, 0.0, 1.5)])

    assert told.objects == ()
    assert (told.view_left, told.farthest) == (0.0, 0.0)


def test_what_is_taught_while_it_runs_is_recognized(
    robot: Begin, map_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    it = robot().know()
    assert it.see([Thing(7, 0.0, 1.5)]).objects == ()

    teach(map_file, "poster 7", [make_view(picture_of(7))], SIZE)
    await_log(it, caplog, "4 taught objects")
    assert [one.object_id for one in it.see([Thing(7, 0.0, 1.5)]).objects] == [4]

    remove_model(map_file, "poster 7")
    await_log(it, caplog, "3 taught objects")
    assert it.see([Thing(7, 0.0, 1.5)]).objects == ()


def await_log(it: Robot, caplog: pytest.LogCaptureFixture, text: str) -> None:
    """Let time pass until the recognizer says that it has read the file again."""
    deadline = time.monotonic() + 20
    caplog.clear()
    while text not in caplog.text:
        it.stage.wait(1.0)
        assert time.monotonic() < deadline


def test_a_map_that_is_damaged_while_it_runs_is_told_and_what_was_known_is_kept(
    robot: Begin, map_file: Path, complaints: Callable[[], str]
) -> None:
    it = robot().know()

    map_file.write_bytes(b"no map " * 100)
    it.stage.wait(1.0)

    assert "still recognizing what was taught before" in complaints()
    assert str(map_file) in complaints()
    assert [one.object_id for one in it.see([Thing(1, 0.0, 1.5)]).objects] == [1]


def test_a_map_that_is_missing_or_damaged_is_refused_when_configured(
    robot: Begin, map_file: Path
) -> None:
    map_file.write_bytes(map_file.read_bytes()[:5000])
    with pytest.raises(CairnError, match=r"a\.cairn.*put back a copy"):
        robot()

    map_file.unlink()
    with pytest.raises(CairnError, match=r"a\.cairn: no such map file"):
        robot()


def test_a_map_without_taught_objects_is_told_and_nothing_is_missed(
    robot: Begin, map_file: Path, complaints: Callable[[], str]
) -> None:
    for seed in (1, 2, 3):
        remove_model(map_file, f"poster {seed}")

    told = robot().know().see([Thing(1, 0.0, 1.5)])

    assert told.objects == ()
    assert told.farthest == 0.0
    assert "no object was taught" in complaints()


@pytest.mark.usefixtures("anew")
def test_the_same_images_give_the_same_sightings(robot: Begin) -> None:
    things = [Thing(1, -0.3, 1.6, 0.4), Thing(2, 0.4, 1.4)]

    first, second = (robot().know().see(things) for _ in range(2))

    assert len(first.objects) == 2
    for one, other in zip(first.objects, second.objects, strict=True):
        assert (one.object_id, one.range, one.bearing) == (
            other.object_id,
            other.range,
            other.bearing,
        )


def test_parameters_that_need_no_other_cameras_can_be_changed(robot: Begin) -> None:
    it = robot().know()
    it.stage.runtime.set_parameters({"farthest": 1.2})
    assert it.see([Thing(1, 0.0, 1.5)]).objects == ()
    with pytest.raises(CairnError, match="map_file is taken when"):
        it.stage.runtime.set_parameters({"map_file": "/tmp/other.cairn"})


def test_a_pair_of_another_size_than_its_calibration_is_told(
    robot: Begin, complaints: Callable[[], str]
) -> None:
    it = robot().know()
    told = it.show(np.full((240, 320), 90, np.uint8), np.full((240, 320), 91, np.uint8))
    assert told is not None
    assert told.objects == ()
    assert "320 x 240" in complaints()
    assert info().width == 640
