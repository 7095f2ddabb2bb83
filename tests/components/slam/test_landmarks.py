"""Landmarks: maps of objects without and with a scanner, gross errors, moved objects, files."""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from cairn.components.slam.graph_file import read_graph, write_graph
from cairn.components.slam.landmarks import LandmarkReport, write_landmarks
from cairn.components.slam.mapping import Mapper
from cairn.planar.motion_model import COMMANDED, MotionModel
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.observations import Observation
from tests.components.slam.object_drive import (
    OBJECTS,
    STEP_NS,
    Base,
    Camera,
    Drive,
    look,
    map_errors,
)


def mapped(
    seconds: float,
    base: Base | None = None,
    camera: Camera | None = None,
    model: MotionModel = COMMANDED,
) -> Mapper:
    drive = Drive(seconds, base or Base())
    if camera is not None:
        drive.camera = camera
    mapper = drive.into(Mapper(10.0, model))
    mapper.finish()
    return mapper


def places(report: LandmarkReport) -> dict[int, tuple[float, float]]:
    return {one.object_id: (one.position.x, one.position.y) for one in report.landmarks}


def trajectory_error(mapper: Mapper, drive: Drive) -> float:
    """Return the root mean square [m] after the alignment of the first pose."""
    start = drive.truth[0]
    poses = mapper.poses()
    cosine, sine = math.cos(start[2]), math.sin(start[2])
    x = start[0] + cosine * poses[:, 0] - sine * poses[:, 1]
    y = start[1] + sine * poses[:, 0] + cosine * poses[:, 1]
    true = np.array([drive.truth[step.stamp_ns // 100_000_000] for step in mapper.trajectory])
    return float(np.sqrt(np.mean((x - true[:, 0]) ** 2 + (y - true[:, 1]) ** 2)))


@pytest.mark.accuracy
def test_objects_make_a_map_although_odometry_turns_too_little() -> None:
    drive = Drive(120.0, Base(turn_gain=0.9, drift=0.002))
    mapper = drive.into(Mapper(10.0, COMMANDED))
    mapper.finish()
    report = mapper.landmarks()
    errors = map_errors(places(report), OBJECTS)
    assert set(errors) == set(OBJECTS)
    assert max(errors.values()) < 0.1
    assert trajectory_error(mapper, drive) < 0.25
    assert not report.moved
    assert not report.uncertain


def test_lag_and_gains_of_commanded_velocities_are_estimated() -> None:
    estimate = mapped(150.0, Base(forward_gain=0.93, turn_gain=0.88, lag_steps=2)).calibration
    assert estimate.calibration.forward_gain == pytest.approx(0.93, abs=0.03)
    assert estimate.calibration.turn_gain == pytest.approx(0.88, abs=0.04)
    assert estimate.calibration.lag_s == pytest.approx(0.2, abs=0.06)
    assert estimate.deviations.turn_gain < 0.05


@pytest.mark.accuracy
def test_calibration_leaves_right_odometry_as_it_is() -> None:
    model = MotionModel(0.0, 0.0, 0.02, 0.04, 0.03)
    calibration = mapped(120.0, model=model).calibration.calibration
    assert calibration.forward_gain == pytest.approx(1.0, abs=0.02)
    assert calibration.turn_gain == pytest.approx(1.0, abs=0.02)
    assert calibration.lag_s == pytest.approx(0.0, abs=0.04)


def test_odometry_without_observations_stays_as_configured() -> None:
    mapper = mapped(20.0, camera=lambda _step, _pose, _seen: ())
    calibration = mapper.calibration.calibration
    assert astuple(calibration) == pytest.approx((1.0, 1.0, 0.0, 0.0))
    assert mapper.landmarks().landmarks == ()


@pytest.mark.accuracy
def test_object_that_is_seen_again_after_a_blind_stretch_corrects_the_trajectory() -> None:
    def camera(step: int, _pose: Pose, seen: list[Observation]) -> list[Observation]:
        return [] if 300 < step < 1000 else seen

    drive = Drive(130.0, Base(drift=0.004), camera=camera)
    mapper = drive.into(Mapper(10.0, COMMANDED))
    # The drift in the blind stretch is 2.4 rad.
    mapper.finish()
    assert max(map_errors(places(mapper.landmarks()), OBJECTS).values()) < 0.15


@pytest.mark.accuracy
def test_gross_errors_do_not_bend_the_map() -> None:
    random = np.random.default_rng(3)

    def camera(_step: int, _pose: Pose, seen: list[Observation]) -> list[Observation]:
        return [
            replace(one, range_m=one.range_m * random.uniform(0.3, 0.7))
            if random.random() < 0.05
            else one
            for one in seen
        ]

    report = mapped(120.0, Base(drift=0.002), camera).landmarks()
    assert max(map_errors(places(report), OBJECTS).values()) < 0.1
    assert report.outliers >= 5


def test_object_that_is_moved_stands_where_it_was_seen_last() -> None:
    def camera(step: int, pose: Pose, seen: list[Observation]) -> list[Observation]:
        if step < 700:
            return seen
        return [moved_by(1.2, pose, one) if one.object_id == 5 else one for one in seen]

    report = mapped(140.0, Base(drift=0.001), camera).landmarks()
    true = {**OBJECTS, 5: (OBJECTS[5][0] + 1.2, OBJECTS[5][1])}
    assert max(map_errors(places(report), true).values()) < 0.12
    (moved,) = report.moved
    assert moved.object_id == 5
    assert math.dist(moved.old, moved.new) == pytest.approx(1.2, abs=0.2)


@pytest.mark.accuracy
def test_object_that_was_seen_twice_is_uncertain() -> None:
    def camera(step: int, _pose: Pose, seen: list[Observation]) -> list[Observation]:
        stray = Observation(99, 2.0, 0.0, 0.01, 0.0004)
        return [*seen, stray] if step in (60, 120) else seen

    report = mapped(60.0, camera=camera).landmarks()
    assert report.uncertain == (99,)
    assert 99 not in places(report)


def test_look_alike_is_assigned_where_one_landmark_fits() -> None:
    def camera(step: int, _pose: Pose, seen: list[Observation]) -> list[Observation]:
        if step < 600:
            return seen
        # From now on, 1 and 3 look the same, and the recognizer names the wrong one.
        other = {1: 3, 3: 1}
        return [
            replace(one, object_id=other[one.object_id], alternatives=(one.object_id,))
            if one.object_id in other
            else one
            for one in seen
        ]

    report = mapped(120.0, camera=camera).landmarks()
    assert max(map_errors(places(report), OBJECTS).values()) < 0.1
    assert report.ambiguous == 0
    assert not report.moved
    before = {one.object_id: one.sightings for one in mapped(60.0).landmarks().landmarks}
    after = {one.object_id: one.sightings for one in report.landmarks}
    assert after[1] > before[1]
    assert after[3] > before[3]


def test_look_alike_without_a_landmark_is_not_mapped() -> None:
    def camera(_step: int, _pose: Pose, seen: list[Observation]) -> list[Observation]:
        return [replace(one, alternatives=(50,)) if one.object_id == 1 else one for one in seen]

    report = mapped(40.0, camera=camera).landmarks()
    assert 1 not in places(report)
    assert report.ambiguous > 5


def test_observations_of_a_robot_that_stands_make_its_landmarks_no_more_certain() -> None:
    one = Observation(1, 2.0, 0.1, 0.05**2, 0.01**2)
    mapper = Mapper(10.0)
    for k in range(50):
        mapper.add_observations(k * 100_000_000, (0.0, 0.0, 0.0), [one])
    (sighting,) = mapper.graph.sightings
    assert (sighting.range_sd, sighting.bearing_sd) == pytest.approx((0.05, 0.01))
    assert len(mapper.keyframes) == 1


@pytest.mark.accuracy
def test_covariance_covers_the_errors() -> None:
    report = mapped(150.0, Base(turn_gain=0.95, drift=0.001)).landmarks()
    errors = map_errors(places(report), OBJECTS)
    for one in report.landmarks:
        deviation = math.sqrt(one.position.xx + one.position.yy)
        assert 0.005 < deviation < 0.2
        assert errors[one.object_id] < 3.5 * deviation


def test_visual_map_has_the_landmarks_with_neutral_reliability(tmp_path: Path) -> None:
    report = mapped(60.0).landmarks()
    write_landmarks(tmp_path / "hall.cairn", "mapped from a test", report.landmarks)
    with open_landmarks(tmp_path / "hall.cairn", read_only=True) as store:
        written = store.landmarks()
    assert {one.object_id: one.position for one in written} == {
        one.object_id: one.position for one in report.landmarks
    }
    assert all(one.reliability == 0.5 for one in written)


def test_landmarks_of_a_graph_file_are_extended(tmp_path: Path) -> None:
    write_graph(tmp_path / "hall.graph", mapped(60.0), "a test")
    mapper = read_graph(tmp_path / "hall.graph")
    before = len(mapper.graph.sightings)
    mapper.resume(here=False)
    Drive(90.0, Base(turn_gain=0.95)).into(mapper)
    mapper.finish()
    report = mapper.landmarks()
    assert len(mapper.graph.sightings) > before
    # Both drives are one map: landmarks connect them.
    assert set(mapper.graph.islands().tolist()) == {0}
    assert mapper.in_map().all()
    assert max(map_errors(places(report), OBJECTS).values()) < 0.1


@pytest.mark.accuracy
@pytest.mark.parametrize("with_objects", [False, True])
def test_objects_show_where_the_robot_is_along_a_corridor(with_objects: bool) -> None:
    """The walls look the same everywhere, and the wheels slip by 15 % on the way back."""
    objects = {1: (3.0, 0.9), 2: (6.0, -0.9), 3: (9.0, 0.9), 4: (12.0, -0.9)}
    random = np.random.default_rng(0)
    mapper = Mapper(5.0)
    angles = np.linspace(-2.0, 2.0, 181)
    with np.errstate(divide="ignore"):
        ranges = np.abs(1.0 / np.sin(angles))
    rays = Rays(np.zeros((181, 2)), angles, np.where(ranges < 5.0, ranges, np.inf), 5.0)
    x = odometry = 0.0
    true = []
    for k in range(200):
        mapper.add_scan(k * 5 * STEP_NS, (odometry, 0.0, 0.0), rays)
        if with_objects:
            seen = look((x, 0.0, 0.0), objects, random)
            mapper.add_observations(k * 5 * STEP_NS, (odometry, 0.0, 0.0), seen)
        true.append(x)
        step = 0.1 if k < 100 else -0.1
        odometry += step
        x += step if k < 100 else 0.85 * step
    mapper.finish()
    error = np.abs(mapper.poses()[:, 0] - true).max()
    assert error < 0.3 if with_objects else error > 1.0, error


def moved_by(dx: float, pose: Pose, one: Observation) -> Observation:
    direction = pose[2] + one.bearing
    x = one.range_m * math.cos(direction) + dx
    y = one.range_m * math.sin(direction)
    bearing = math.remainder(math.atan2(y, x) - pose[2], math.tau)
    return replace(one, range_m=math.hypot(x, y), bearing=bearing)
