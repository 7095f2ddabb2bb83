"""What observers record is what is read again; estimates are compared with the ground truth."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from cairn import SECOND, CairnError, from_ns
from cairn.planar.messages import packed_poses, pose_message, with_covariance
from cairn.schemas.cairn_msgs import (
    ObjectEvidence,
    ObjectEvidenceArray,
    RecognizedObject,
    RecognizedObjectArray,
    VisualMap,
    VisualMapChange,
    VisualObject,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.geometry_msgs import PoseArray, PoseStamped
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from cairn_lab.experiments.observer import MethodObserver, WorldObserver
from cairn_lab.experiments.series import (
    ObservedObject,
    TrueMove,
    error_curve,
    read_method,
    read_world,
)
from lab_tests.experiments.recorded import method_series, world_series

SURVEY = (0.0, {1: (2.0, 0.0)})


def at(seconds: float) -> Header:
    return Header(stamp=from_ns(round(seconds * SECOND)), frame_id="map")


def true_map(seconds: float, *positions: tuple[int, float, float]) -> VisualMap:
    objects = tuple(VisualObject(object_id=i, x=x, y=y) for i, x, y in positions)
    return VisualMap(header=at(seconds), objects=objects)


def test_ground_truth_is_recorded(tmp_path: Path) -> None:
    file = tmp_path / "world.jsonl"
    observer = ComponentHarness(WorldObserver, {"file": str(file)})
    observer.publish("true_map", true_map(0.0, (1, 2.0, 3.0), (2, 4.0, 5.0)))
    observer.publish("truth", PoseStamped(header=at(1.0), pose=pose_message((0.0, 0.0, 3.0))))
    observer.publish("truth", PoseStamped(header=at(2.0), pose=pose_message((1.0, 2.0, -3.0))))
    one = RecognizedObject(object_id=2, range=1.5, bearing=-0.2)
    recognized = RecognizedObjectArray(header=at(2.0), objects=(one,))
    observer.publish("recognized_objects", recognized)
    observer.publish("true_map", true_map(3.0, (1, 2.0, 3.0), (2, 4.5, 5.0)))
    observer.request("shutdown")

    world = read_world(file)
    assert world.moves == (TrueMove(3.0, 2, (4.0, 5.0), (4.5, 5.0)),)
    assert world.positions(2.9)[2] == (4.0, 5.0)
    assert world.positions(3.0)[2] == (4.5, 5.0)
    assert world.observations == (ObservedObject(2.0, 2, 1.5, -0.2),)
    x, y, theta = world.true_poses(np.array([1.5]))[0]
    assert (x, y) == (0.5, 1.0)
    assert math.cos(theta) == pytest.approx(-1.0)  # the short way from 3 to -3 rad


def test_estimates_of_a_method_are_recorded(tmp_path: Path) -> None:
    file = tmp_path / "ours.jsonl"
    observer = ComponentHarness(MethodObserver, {"file": str(file)})
    for stamp, state in ((1.0, 0), (2.0, 0), (3.0, 1)):
        landmark = VisualObject(object_id=7, x=1.0, y=2.0, reliability=0.9, state=state)
        observer.publish("visual_map", VisualMap(header=at(stamp), objects=(landmark,)))
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.16]])
    pose = with_covariance((1.0, 2.0, 0.5), covariance)
    estimate = LocalizationEstimate(header=at(1.0), located=True, pose=pose)
    observer.publish("localization", estimate)
    change = VisualMapChange(
        header=at(3.0), object_id=7, kind=1, old_x=1.0, old_y=2.0, reason="moved"
    )
    observer.publish("visual_map_changes", change)
    evidence = ObjectEvidence(
        object_id=7,
        similarity=0.1,
        verdict=1,
        distance=3.0,
        x=4.0,
        y=5.0,
        covariance=np.zeros(4),
        range=2.0,
        bearing=0.1,
    )
    frame = ObjectEvidenceArray(
        header=at(2.5), robot_x=1.0, robot_y=2.0, robot_theta=0.5, evidence=(evidence,)
    )
    observer.publish("object_evidence", frame)
    particles = np.array([[0.0, 0.0, math.pi - 0.1], [2.0, 0.0, -math.pi + 0.1]])
    observer.publish("particles", PoseArray(header=at(2.0), poses=packed_poses(particles)))
    observer.request("shutdown")

    series = read_method(file)
    np.testing.assert_allclose(series.poses, [[1.0, 2.0, 0.5]], atol=1e-5)
    np.testing.assert_allclose(series.variances, [[0.04, 0.01, 0.09, 0.16]])
    np.testing.assert_allclose(series.particles, [[2.0, 1.0, 0.0, 0.01]], atol=1e-6)
    assert [one.live for one in series.landmarks] == [True, False]  # unchanged ones only once
    assert series.map_at(2.9)[7].live
    assert not series.map_at(3.0)[7].live
    assert (series.changes[0].old, series.changes[0].new) == ((1.0, 2.0), None)
    assert series.evidence[0].position == (4.0, 5.0)
    assert series.evidence[0].robot == (1.0, 2.0, 0.5)


def test_other_files_are_rejected(tmp_path: Path) -> None:
    file = tmp_path / "ours.jsonl"
    file.write_text('["pose", 1.0, 2.0\n')

    with pytest.raises(CairnError, match=r"ours\.jsonl: this file is not a series"):
        read_method(file)
    with pytest.raises(CairnError, match="not a series"):
        read_world(tmp_path / "none.jsonl")


def test_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="cannot be written: No such file"):
        ComponentHarness(MethodObserver, {"file": str(tmp_path / "none" / "ours.jsonl")})


def test_errors_are_averaged_in_steps() -> None:
    found = error_curve(method_series(off=0.3, until=10.0), world_series(SURVEY), 20.0)

    assert found.stamps[:2].tolist() == [0.25, 0.75]
    assert len(found.stamps) == 40
    np.testing.assert_allclose(found.position_error[:20], 0.3)
    np.testing.assert_allclose(found.position_sigma[:20], 0.05)  # sqrt(0.03^2 + 0.04^2)
    np.testing.assert_allclose(found.position_spread[:20], 0.02)
    np.testing.assert_allclose(found.heading_spread[:20], 0.01)
    assert np.isnan(found.position_error[20:]).all()
    assert found.lost_share == 0.5


def test_heading_errors_are_wrapped() -> None:
    series = method_series()
    series.poses[:, 2] = np.pi - 0.1
    truth = world_series(SURVEY, poses=[(0.0, 0.0, -np.pi + 0.1)] * 201)

    np.testing.assert_allclose(error_curve(series, truth, 20.0).heading_error, 0.2)
