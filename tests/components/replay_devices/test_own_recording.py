"""A recording of Cairn is replayed as those of other robots: scans, odometry, objects, truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cairn import SECOND, from_ns
from cairn.components.replay_devices.camera import ReplayCamera
from cairn.components.replay_devices.components import ReplayRecognizer, ReplayTruth
from cairn.components.replay_devices.open_recording import open_recording
from cairn.planar.messages import pose_message
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray, VisualMap
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import CameraInfo, Image, LaserScan
from cairn.schemas.std_msgs import Header
from tests.cairn.recording.recordings import BEGIN, Sent, text, write_recording
from tests.cairn.vision.cameras import info
from tests.components.replay_devices.conftest import start

COUNT = 5


def scan(header: Header) -> LaserScan:
    return LaserScan(
        header=header, angle_min=-1.0, angle_max=1.0, angle_increment=0.5, range_min=0.1,
        range_max=5.0, ranges=np.array([1, 2, 3, 4, 5], np.float32),
    )  # fmt: skip


def seen(header: Header, bearing: float) -> RecognizedObjectArray:
    return RecognizedObjectArray(
        header=header,
        objects=(RecognizedObject(object_id=3, range=2.0, bearing=bearing, inliers=7),),
        view_left=0.5,
        farthest=4.0,
    )


def calibration(side: str) -> CameraInfo:
    """Return that of a camera whose images have 16 x 16 pixels."""
    return replace(info(side), width=16, height=16)


def drive() -> list[Sent]:
    sent = [Sent("/robot/true_map", 0, VisualMap(), node="/robot/world", latched=True)]
    for k in range(COUNT):
        header = Header(stamp=from_ns(BEGIN + k * SECOND))
        pose = pose_message((0.1 * k, 0.0, 0.0))
        pixels = np.full(256, k, np.uint8)
        image = Image(header=header, height=16, width=16, encoding="mono8", step=16, data=pixels)
        for topic, message in (
            ("scan", scan(header)),
            ("other/scan_raw", scan(header)),
            ("odom", Odometry(header=header, child_frame_id="base_link")),
            ("map_odom", Odometry(header=header)),
            ("truth", PoseStamped(header=header, pose=pose)),
            ("goal_pose", PoseStamped(header=header, pose=pose)),
            ("recognized_objects", seen(header, 0.01 * k)),
            ("left_image", image),
            ("right_image", image),
            ("left_info", calibration("left")),
            ("right_info", calibration("right")),
            ("log", text("not replayed")),
        ):
            sent.append(Sent(f"/robot/{topic}", k * SECOND, message))
    return sent


@pytest.fixture(params=["closed", "killed", "split"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A recording that is whole, one whose recorder was killed, and one of two files."""
    if request.param == "split":
        sent = drive()
        write_recording(tmp_path / "run.mcap", sent[:25])
        write_recording(tmp_path / "run_2.mcap", [sent[0], *sent[25:]])
        return tmp_path
    return write_recording(
        tmp_path / f"{request.param}.mcap", drive(), close=request.param == "closed"
    )


def test_all_streams_of_a_recording_are_found(recording: Path) -> None:
    opened = open_recording(recording)

    stamps = [BEGIN + k * SECOND for k in range(COUNT)]
    scans, odometry, objects = opened.scans(), opened.odometry(), opened.observations()
    truth, images = opened.truth(), opened.images()
    assert scans is not None
    assert odometry is not None
    assert objects is not None
    assert truth is not None
    assert images is not None
    for stream in (scans, odometry, objects, truth, images):
        assert list(stream.stamps) == stamps
    assert truth.poses[:, 0] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert (images.cameras, images.size) == (2, (16, 16))
    assert [int(images.load(k)[1][0, 0]) for k in range(COUNT)] == [0, 1, 2, 3, 4]
    assert images.infos == (calibration("left"), calibration("right"))
    assert opened.landmark_map() == VisualMap()
    replayed = {topic.topic: topic.kind for topic in opened.topics() if topic.kind}
    assert replayed["/robot/scan"] == "scan"
    assert replayed["/robot/recognized_objects"] == "objects"
    assert any("cut off" in note for note in opened.notes()) == (recording.name == "killed.mcap")


def test_images_are_replayed_with_their_recorded_calibration(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = write_recording(tmp_path / "run.mcap", drive())
    camera = start(ReplayCamera, BEGIN / SECOND, recording=str(file))

    camera.run_for(COUNT)

    assert [message.p.tolist() for message in camera.take("right_info")] == [
        calibration("right").p.tolist()
    ] * COUNT
    assert len(camera.take("left_image")) == COUNT
    assert "no calibration" not in caplog.text


def test_observations_are_replayed_as_they_were_published(tmp_path: Path) -> None:
    file = write_recording(tmp_path / "run.mcap", drive())
    recognizer = start(ReplayRecognizer, BEGIN / SECOND, recording=str(file))
    truth = start(ReplayTruth, BEGIN / SECOND, recording=str(file))

    recognizer.run_for(COUNT)
    truth.run_for(COUNT)

    assert recognizer.take("objects") == [
        seen(Header(stamp=from_ns(BEGIN + k * SECOND)), 0.01 * k) for k in range(COUNT)
    ]
    assert len(truth.take("truth")) == COUNT
    assert truth.take("true_map") == [VisualMap()]
