"""Tests of the recognizer with simulated cameras, in lockstep."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.testing.lockstep import DeploymentHarness
from tests.commands import cairn

pytestmark = pytest.mark.images


WORLD = Path(__file__).parents[3] / "deploy" / "worlds" / "room.yaml"
MOUNT = {"x": 0.1, "y": 0.0, "theta": 0.0}
START = {"x": 4.7, "y": 4.9, "theta": math.pi / 2}


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("surveyed") / "room.cairn"
    assert cairn("map", "import", "world", str(WORLD), str(path)).code == 0
    return path


def run_recognizer(
    folder: Path, map_file: Path, fault: str, seconds: int = 2
) -> list[RecognizedObjectArray]:
    """Return what a robot in front of objects 3 and 4 publishes.

    The run is longer than the time limits for missing right images and for frozen images (1 s).
    """
    world = yaml.safe_load(WORLD.read_text(encoding="utf-8"))
    world["robot"] = START
    for thing in world["objects"]:
        if "texture" in thing:
            thing["texture"] = str(WORLD.parent / thing["texture"])
    (folder / "world.yaml").write_text(yaml.safe_dump(world))
    page: dict[str, Any] = {
        "cairn": 1,
        "components": {
            "world": {
                "plugin": "simulated_world",
                "parameters": {"world": str(folder / "world.yaml")},
            },
            "base": {"plugin": "simulated_base"},
            "camera": {
                "plugin": "simulated_stereo_camera",
                "parameters": {"mount": MOUNT, "fault": fault},
            },
            "recognizer": {
                "plugin": "object_recognizer",
                "parameters": {"mount": MOUNT, "map_file": str(map_file)},
            },
            "ending": {
                "plugin": "tests.components.object_recognizer.poster_camera:Ending",
                "parameters": {"after_s": seconds},
                "significant": True,
                "restart": "transient",
            },
        },
        "external_topics": ["cmd_vel"],
    }
    (folder / "run.yaml").write_text(yaml.safe_dump(page, sort_keys=False))
    with DeploymentHarness(folder / "run.yaml") as harness:
        objects = harness.read("objects", RecognizedObjectArray)
        assert harness.run_to_end().normal
    return objects.messages


def assert_position(one: RecognizedObject) -> None:
    """Assert that the object is at its position in the world file."""
    x, y = {3: (3.8, 7.0), 4: (5.6, 7.0)}[one.object_id]
    ahead, left = y - START["y"], START["x"] - x
    assert one.range == pytest.approx(math.hypot(ahead, left), abs=4 * math.sqrt(one.covariance[0]))
    assert one.range == pytest.approx(math.hypot(ahead, left), rel=0.05)
    assert one.bearing == pytest.approx(math.atan2(left, ahead), abs=0.01)


@pytest.mark.accuracy
def test_objects_in_view_are_published_at_their_positions(tmp_path: Path, surveyed: Path) -> None:
    frames = run_recognizer(tmp_path, surveyed, "none")

    assert len(frames) >= 8
    published = [one for frame in frames for one in frame.objects]
    assert {one.object_id for one in published} == {3, 4}
    assert len(published) > 0.9 * 2 * len(frames)
    for one in published:
        assert_position(one)


@pytest.mark.parametrize("fault", ["right_missing", "right_frozen"])
def test_one_camera_is_enough_for_known_sizes(tmp_path: Path, surveyed: Path, fault: str) -> None:
    published = [
        one for frame in run_recognizer(tmp_path, surveyed, fault)[-5:] for one in frame.objects
    ]

    assert {one.object_id for one in published} == {3, 4}
    for one in published:
        assert_position(one)


def test_missing_left_camera_publishes_nothing(tmp_path: Path, surveyed: Path) -> None:
    assert run_recognizer(tmp_path, surveyed, "left_missing") == []


def test_frozen_cameras_publish_only_once(tmp_path: Path, surveyed: Path) -> None:
    assert len(run_recognizer(tmp_path, surveyed, "frozen")) == 1


@pytest.mark.accuracy
def test_swapped_cameras_publish_no_object(tmp_path: Path, surveyed: Path) -> None:
    frames = run_recognizer(tmp_path, surveyed, "swapped")

    assert len(frames) > 1
    assert [one for frame in frames[1:] for one in frame.objects] == []
    assert all(frame.farthest == 0 for frame in frames[1:])
