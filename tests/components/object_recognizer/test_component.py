"""Tests of the component: published objects, their positions, and the field of view."""

import logging
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import add_views, remove_model
from tests.components.object_recognizer.conftest import Robot
from tests.components.object_recognizer.scenes import SIZE, Thing, info, picture_of
from tests.patience import LIMIT_S
from tests.sweeps import sampled

pytestmark = pytest.mark.images


Start = Callable[..., Robot]


def test_object_is_published_with_position_corners_and_stamp(robot: Start) -> None:
    it = robot().calibrate()

    published = it.see([Thing(1, x=0.2, z=1.5)])

    assert published.header.frame_id == "base_link"
    assert published.header.stamp.sec + published.header.stamp.nanosec / 1e9 == pytest.approx(
        it.now_s
    )
    (one,) = published.objects
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
@pytest.mark.parametrize("seed", sampled([1, 3]))
def test_errors_match_the_covariance(robot: Start, stereo: bool, seed: int) -> None:
    it = robot(stereo=stereo).calibrate()
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
        assert nis == []  # its size is unknown, and the right camera is missing
        return
    assert len(nis) >= 7
    assert np.mean(nis) < 4.0  # 2 if the covariance is exact, less if it is conservative
    assert max(nis) < 13.8


def test_several_objects_and_instances_are_published(robot: Start) -> None:
    it = robot().calibrate()

    published = it.see([Thing(1, -0.5, 1.6), Thing(1, 0.0, 1.6), Thing(2, 0.5, 1.6)])

    assert [one.object_id for one in sorted(published.objects, key=lambda one: -one.bearing)] == [
        1,
        1,
        2,
    ]


def test_unknown_objects_are_not_published(robot: Start) -> None:
    published = robot().calibrate().see([Thing(77, 0.0, 1.2), Thing(78, 0.5, 1.6)])

    assert published.objects == ()
    assert published.view_left > published.view_right


def test_positions_are_relative_to_the_base(robot: Start) -> None:
    it = robot(mount={"x": 0.3, "y": -0.1, "theta": math.pi / 2}).calibrate()

    published = it.see([Thing(1, x=0.2, z=1.5)])

    # Forward of the camera is left of the robot, right of the camera is forward of the robot.
    (one,) = published.objects
    x, y = 0.3 + 0.2, -0.1 + 1.5
    assert one.range == pytest.approx(math.hypot(x, y), abs=0.03)
    assert one.bearing == pytest.approx(math.atan2(y, x), abs=0.01)
    assert published.view_right < math.pi / 2 < published.view_left


def test_field_of_view_contains_complete_objects_only(robot: Start) -> None:
    published = robot(nearest=0.5, farthest=4.0).calibrate().see([])

    half = math.atan(320 / 500)
    assert 0.7 * half < published.view_left < half
    assert -half < published.view_right < -0.7 * half
    assert 0.5 < published.nearest < published.farthest < 4.0


@pytest.mark.parametrize("limits", [{"nearest": 1.6}, {"nearest": 0.2, "farthest": 1.4}])
def test_objects_out_of_range_are_not_published(robot: Start, limits: dict[str, float]) -> None:
    assert robot(**limits).calibrate().see([Thing(1, 0.0, 1.5)]).objects == ()


def test_unpublished_detections_clear_the_field_of_view(robot: Start) -> None:
    published = robot(least_inliers=1000).calibrate().see([Thing(1, 0.0, 1.5)])

    assert published.objects == ()
    assert (published.view_left, published.farthest) == (0.0, 0.0)


def test_objects_taught_at_run_time_are_recognized(
    robot: Start, map_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    it = robot().calibrate()
    assert it.see([Thing(7, 0.0, 1.5)]).objects == ()

    add_views(map_file, "poster 7", [make_view(picture_of(7))], SIZE)
    await_log(it, caplog, "loaded 4 object models")
    assert [one.object_id for one in it.see([Thing(7, 0.0, 1.5)]).objects] == [4]

    remove_model(map_file, "poster 7")
    await_log(it, caplog, "loaded 3 object models")
    assert it.see([Thing(7, 0.0, 1.5)]).objects == ()


def await_log(it: Robot, caplog: pytest.LogCaptureFixture, text: str) -> None:
    """Advance time until the recognizer logs that it has reloaded the file."""
    deadline = time.monotonic() + LIMIT_S
    caplog.clear()
    while text not in caplog.text:
        it.recognizer.run_for(1.0)
        assert time.monotonic() < deadline


def test_map_damaged_at_run_time_is_reported_and_models_are_kept(
    robot: Start, map_file: Path, warnings: Callable[[], str]
) -> None:
    it = robot().calibrate()

    map_file.write_bytes(b"not a map " * 100)
    it.recognizer.run_for(1.0)

    assert "keeping the object models loaded before" in warnings()
    assert str(map_file) in warnings()
    assert [one.object_id for one in it.see([Thing(1, 0.0, 1.5)]).objects] == [1]


def test_missing_or_damaged_map_fails_configuration(robot: Start, map_file: Path) -> None:
    map_file.write_bytes(map_file.read_bytes()[:5000])
    with pytest.raises(CairnError, match=r"a\.cairn.*restore a copy"):
        robot()

    map_file.unlink()
    with pytest.raises(CairnError, match=r"a\.cairn: no such map file"):
        robot()


def test_map_without_models_is_reported_and_nothing_counts_as_missing(
    robot: Start, map_file: Path, warnings: Callable[[], str]
) -> None:
    for seed in (1, 2, 3):
        remove_model(map_file, f"poster {seed}")

    published = robot().calibrate().see([Thing(1, 0.0, 1.5)])

    assert published.objects == ()
    assert published.farthest == 0.0
    assert "no object model in" in warnings()


@pytest.mark.usefixtures("uncached")
def test_recognition_is_repeatable(robot: Start) -> None:
    things = [Thing(1, -0.3, 1.6, 0.4), Thing(2, 0.4, 1.4)]

    first, second = (robot().calibrate().see(things) for _ in range(2))

    assert len(first.objects) == 2
    for one, other in zip(first.objects, second.objects, strict=True):
        assert (one.object_id, one.range, one.bearing) == (
            other.object_id,
            other.range,
            other.bearing,
        )


def test_run_time_parameters_can_be_changed_and_others_cannot(robot: Start) -> None:
    it = robot().calibrate()
    it.recognizer.set_parameters({"farthest": 1.2})
    assert it.see([Thing(1, 0.0, 1.5)]).objects == ()
    with pytest.raises(CairnError, match="map_file can only be set when"):
        it.recognizer.set_parameters({"map_file": "/tmp/other.cairn"})


def test_images_of_another_size_than_the_calibration_are_reported(
    robot: Start, warnings: Callable[[], str]
) -> None:
    it = robot().calibrate()
    published = it.show(np.full((240, 320), 90, np.uint8), np.full((240, 320), 91, np.uint8))
    assert published is not None
    assert published.objects == ()
    assert "320 x 240" in warnings()
    assert info().width == 640
