"""Test of localizer and map builder on a real recording: a displaced landmark is corrected."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cairn.components.map_builder.importing import alter
from cairn.components.replay_devices.mrclam import MrclamDataset, read_landmarks
from cairn.schemas.cairn_msgs import VisualMap, VisualMapChange, VisualObject
from cairn.schemas.geometry_msgs import PoseWithCovarianceStamped
from cairn.testing.lockstep import DeploymentHarness
from cairn.visual_map.new_map import write_map
from tests.sweeps import sampled

pytestmark = pytest.mark.slow


# Of 886 s: it is registered within 190 s and 160 s, and must stay there.
END_S = {2: 400.0, 5: 210.0}


def deployment(dataset: Path, robot: int, map_file: Path, start: dict[str, float]) -> Any:
    recording = {"recording": str(dataset), "robot": robot, "end_s": END_S[robot]}
    copy = map_file.with_name("working.map")
    return {
        "cairn": 1,
        "robot": "robot",
        "clock": "simulated",
        "components": {
            "odometry": {
                "plugin": "components.replay_devices.components:ReplayOdometry",
                "parameters": recording,
            },
            "sightings": {
                "plugin": "components.replay_devices.components:ReplayRecognizer",
                "parameters": recording,
            },
            "map_builder": {
                "plugin": "components.map_builder.component:MapBuilder",
                "parameters": {"map_file": str(map_file), "working_copy": str(copy)},
            },
            "localizer": {
                "plugin": "components.localizer.component:Localizer",
                "parameters": {"start": start},
            },
            "clock": {
                "plugin": "components.replay_devices.pacing:ReplayClock",
                "parameters": {**recording, "rate": 10.0},
                "topics": {"time": "clock"},
                "significant": True,
                "restart": "transient",
            },
        },
    }


# Robot 5 confuses many landmarks, is lost at times, and may remove an unmoved landmark: it must
# restore it.
@pytest.mark.accuracy
@pytest.mark.parametrize(
    ("robot", "object_id", "may_remove_others"), sampled([(2, 13, False), (5, 13, True)])
)
def test_displaced_landmark_is_registered_at_its_true_position(
    dataset: Path, tmp_path: Path, robot: int, object_id: int, may_remove_others: bool
) -> None:
    map_file = tmp_path / "hall.map"
    surveyed = read_landmarks(dataset)
    write_map(map_file, "a test", alter(surveyed, {object_id: (-1.2, 0.7)}, []))
    truth = MrclamDataset(dataset).truth(robot)
    first = MrclamDataset(dataset).odometry(robot)[0, 0]
    x, y, theta = (float(np.interp(first, truth[:, 0], truth[:, k])) for k in (1, 2, 3))
    page = deployment(dataset, robot, map_file, {"x": x, "y": y, "theta": theta})
    file = tmp_path / "run.yaml"
    file.write_text(yaml.safe_dump(page, sort_keys=False))

    with DeploymentHarness(file) as harness:
        poses = harness.read("pose", PoseWithCovarianceStamped)
        maps = harness.read("visual_map", VisualMap)
        changes = harness.read("visual_map_changes", VisualMapChange)
        assert harness.run_to_end().normal

    kinds = {(c.object_id, c.kind) for c in changes.messages}
    assert (object_id, VisualMapChange.REMOVED) in kinds
    assert may_remove_others or {i for i, kind in kinds if kind == VisualMapChange.REMOVED} == {
        object_id
    }
    final = {o.object_id: o for o in maps.messages[-1].objects}
    assert {o.state for o in final.values()} == {VisualObject.LIVE}
    for true in surveyed.objects:
        found = final[true.object_id]
        assert math.hypot(found.x - true.x, found.y - true.y) < 0.3
    # Robot 2 is lost for 40 s, in which it hardly sees other landmarks: 0.29 to 0.42 m with seeds 0
    # to 3.
    assert _rmse(poses.messages, truth) < 0.50


def _rmse(poses: list[PoseWithCovarianceStamped], truth: Any) -> float:
    time = np.array([p.header.stamp.sec + p.header.stamp.nanosec / 1e9 for p in poses])
    x = np.array([p.pose.pose.position.x for p in poses])
    y = np.array([p.pose.pose.position.y for p in poses])
    dx = x - np.interp(time, truth[:, 0], truth[:, 1])
    dy = y - np.interp(time, truth[:, 0], truth[:, 2])
    return float(np.sqrt(np.mean(dx**2 + dy**2)))
