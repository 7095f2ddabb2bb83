"""What observers write down is what is read again."""

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
from cairn.tools.experiments.observer import PairObserver, WorldObserver
from cairn.tools.experiments.series import Move, Sighting, read_pair, read_world


def at(seconds: float) -> Header:
    return Header(stamp=from_ns(round(seconds * SECOND)), frame_id="map")


def true_map(seconds: float, *places: tuple[int, float, float]) -> VisualMap:
    objects = tuple(VisualObject(object_id=i, x=x, y=y) for i, x, y in places)
    return VisualMap(header=at(seconds), objects=objects)


def test_what_was_true_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "world.jsonl"
    it = ComponentHarness(WorldObserver, {"file": str(file)})

    it.publish("true_map", true_map(0.0, (1, 2.0, 3.0), (2, 4.0, 5.0)))
    it.publish("truth", PoseStamped(header=at(1.0), pose=pose_message((0.0, 0.0, 3.0))))
    it.publish("truth", PoseStamped(header=at(2.0), pose=pose_message((1.0, 2.0, -3.0))))
    seen = RecognizedObject(object_id=2, range=1.5, bearing=-0.2)
    it.publish("recognized_objects", RecognizedObjectArray(header=at(2.0), objects=(seen,)))
    it.publish("true_map", true_map(3.0, (1, 2.0, 3.0), (2, 4.5, 5.0)))
    it.request("shutdown")

    world = read_world(file)
    assert world.moves == (Move(3.0, 2, (4.0, 5.0), (4.5, 5.0)),)
    assert world.places(2.9)[2] == (4.0, 5.0)
    assert world.places(3.0)[2] == (4.5, 5.0)
    assert world.sightings == (Sighting(2.0, 2, 1.5, -0.2),)
    x, y, theta = world.truth(np.array([1.5]))[0]
    assert (x, y) == (0.5, 1.0)
    assert math.cos(theta) == pytest.approx(-1.0)  # the short way from 3 to -3 rad


def test_what_a_pair_told_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "ours.jsonl"
    it = ComponentHarness(PairObserver, {"file": str(file)})

    for stamp, live in ((1.0, 0), (2.0, 0), (3.0, 1)):
        thing = VisualObject(object_id=7, x=1.0, y=2.0, reliability=0.9, state=live)
        it.publish("visual_map", VisualMap(header=at(stamp), objects=(thing,)))
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.16]])
    told = with_covariance((1.0, 2.0, 0.5), covariance)
    it.publish("localization", LocalizationEstimate(header=at(1.0), located=True, pose=told))
    change = VisualMapChange(header=at(3.0), object_id=7, kind=1, old_x=1.0, old_y=2.0, reason="no")
    it.publish("visual_map_changes", change)
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
    it.publish("object_evidence", frame)
    cloud = np.array([[0.0, 0.0, math.pi - 0.1], [2.0, 0.0, -math.pi + 0.1]])
    it.publish("particles", PoseArray(header=at(2.0), poses=packed_poses(cloud)))
    it.request("shutdown")

    pair = read_pair(file)
    np.testing.assert_allclose(pair.poses, [[1.0, 2.0, 0.5]], atol=1e-5)
    np.testing.assert_allclose(pair.variances, [[0.04, 0.01, 0.09, 0.16]])
    np.testing.assert_allclose(pair.clouds, [[2.0, 1.0, 0.0, 0.01]], atol=1e-6)
    assert [one.live for one in pair.mapped] == [True, False]  # it was as before in between
    assert pair.map_at(2.9)[7].live
    assert not pair.map_at(3.0)[7].live
    assert (pair.changes[0].old, pair.changes[0].new) == ((1.0, 2.0), None)
    assert pair.evidence[0].place == (4.0, 5.0)
    assert pair.evidence[0].robot == (1.0, 2.0, 0.5)


def test_a_file_that_is_no_series_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "ours.jsonl"
    file.write_text('["pose", 1.0, 2.0\n')

    with pytest.raises(CairnError, match=r"ours\.jsonl: not a series of an experiment"):
        read_pair(file)
    with pytest.raises(CairnError, match="not a series"):
        read_world(tmp_path / "none.jsonl")


def test_a_folder_that_is_not_there_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="cannot be written: No such file"):
        ComponentHarness(PairObserver, {"file": str(tmp_path / "none" / "ours.jsonl")})
