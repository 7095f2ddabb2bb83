"""Images of folders and videos are replayed as a camera sends them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from cairn import SECOND, to_ns
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.pacing import ReplayClock
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.testing.lockstep import DeploymentHarness, LockstepReading
from tests.cairn.vision.cameras import HEIGHT, WIDTH, info
from tests.commands import cairn
from tests.components.replay_devices.conftest import start
from tests.components.replay_devices.image_recordings import (
    calibrations,
    numbered_image,
    pairs,
    replayed,
    save,
    shade,
    video,
)
from tests.wording import assert_words

pytestmark = pytest.mark.images


def test_folder_of_pairs_is_a_stereo_camera(tmp_path: Path) -> None:
    folder = pairs(tmp_path / "images", 12)

    harness = replayed(folder, image_rate_hz=5.0, **calibrations(tmp_path / "calibration"))

    left, right = harness.take("left_image"), harness.take("right_image")
    # In natural order: 10 and 11 come after 9.
    assert [shade(image) for image in left] == [10 + 10 * n for n in range(12)]
    assert [shade(image) for image in right] == [15 + 10 * n for n in range(12)]
    assert (left[0].encoding, left[0].width, left[0].height, left[0].step) == (
        "mono8",
        320,
        240,
        320,
    )
    stamps = [to_ns(image.header.stamp) for image in left]
    assert set(np.diff(stamps)) == {SECOND // 5}
    assert left[0].header.frame_id == "left_camera_optical_frame"
    assert right[0].header.frame_id == "right_camera_optical_frame"
    infos = harness.take("left_info"), harness.take("right_info")
    for messages in (right, *infos):
        assert [to_ns(message.header.stamp) for message in messages] == stamps
    assert infos[1][0].p.tolist() == info("right").p.tolist()
    assert infos[1][0].header.frame_id == "right_camera_optical_frame"


def test_folders_of_two_numbered_cameras_are_a_stereo_camera(tmp_path: Path) -> None:
    save(tmp_path, "cam0/1.png", "cam0/2.png", "cam1/1.png", "cam1/2.png")

    harness = replayed(tmp_path, image_rate_hz=5.0)

    assert [shade(image) for image in harness.take("left_image")] == [10, 20]
    assert [shade(image) for image in harness.take("right_image")] == [30, 40]


def test_images_of_one_camera_are_published_as_left_ones(tmp_path: Path) -> None:
    folder = save(tmp_path / "mono", "a1.png", "a2.png", "a10.png")

    harness = replayed(folder, image_rate_hz=1.0)

    assert [shade(image) for image in harness.take("left_image")] == [10, 20, 30]
    # As in ROS, the info of a camera that is not calibrated holds only its size.
    left_info = harness.take("left_info")[0]
    assert (left_info.width, left_info.height, left_info.k.any()) == (WIDTH, HEIGHT, False)
    assert harness.take("right_image") == harness.take("right_info") == []


def test_side_by_side_images_are_split(tmp_path: Path) -> None:
    wide = np.hstack((numbered_image(40), numbered_image(90)))
    (tmp_path / "wide").mkdir()
    cv2.imwrite(str(tmp_path / "wide" / "0.png"), wide)

    harness = replayed(
        tmp_path / "wide", image_rate_hz=1.0, side_by_side=True,
        **calibrations(tmp_path / "calibration"),
    )  # fmt: skip

    (left,), (right,) = harness.take("left_image"), harness.take("right_image")
    assert (shade(left), shade(right)) == (40, 90)
    assert (left.width, right.width) == (WIDTH, WIDTH)


@pytest.mark.parametrize(
    ("names", "times", "stamps"),
    [
        (
            ("1700000000.250000.png", "1700000000.5.png"),
            None,
            (1_700_000_000_250, 1_700_000_000_500),
        ),
        (("1700000000123456789.png", "1700000000223456789.png"), None, (1_700_000_000_123, None)),
        (("img_1700000000123.png", "img_1700000000223.png"), None, (1_700_000_000_123, None)),
        (("0.png", "1.png"), "# seconds\n12.5\n12.75\n", (12_500, 12_750)),
        (("b.png", "a.png"), "3.5 b.png\n3.25 a.png\n", (3_250, 3_500)),
        (
            ("0.png", "1.png"),
            "1700000000123456789\n1700000000623456789\n",
            (1_700_000_000_123, None),
        ),
    ],
)
def test_times_come_from_names_or_from_a_table(
    tmp_path: Path, names: tuple[str, ...], times: str | None, stamps: tuple[int, int | None]
) -> None:
    save(tmp_path, *names)
    if times is not None:
        (tmp_path / "times.txt").write_text(times)

    images = open_recording(tmp_path).images()

    assert images is not None
    assert images.stamps[0] // 1_000_000 == stamps[0]
    if stamps[1] is not None:
        assert images.stamps[1] // 1_000_000 == stamps[1]


def test_table_of_names_applies_to_pairs(tmp_path: Path) -> None:
    save(tmp_path, "left/0.png", "left/1.png", "right/0.png", "right/1.png")
    (tmp_path / "times.txt").write_text("1.0\n2.0\n")

    images = open_recording(tmp_path).images()

    assert images is not None
    assert (images.cameras, list(images.stamps)) == (2, [SECOND, 2 * SECOND])


def test_video_is_replayed_at_its_own_or_another_rate(tmp_path: Path) -> None:
    file = video(tmp_path / "run.avi", 5, fps=10.0)

    own = replayed(file).take("left_image")
    slow = replayed(file, image_rate_hz=2.0).take("left_image")

    assert [round(shade(image), -1) for image in own] == [10, 20, 30, 40, 50]
    for taken, rate in ((own, 10), (slow, 2)):
        assert set(np.diff([to_ns(image.header.stamp) for image in taken])) == {SECOND // rate}


def test_videos_of_both_cameras_are_a_stereo_camera(tmp_path: Path) -> None:
    folder = tmp_path / "videos"
    video(folder / "left.avi", 5)
    video(folder / "right.avi", 3, start=60)

    harness = replayed(folder)

    left, right = harness.take("left_image"), harness.take("right_image")
    assert [round(shade(image), -1) for image in left] == [10, 20, 30]
    assert [round(shade(image), -1) for image in right] == [60, 70, 80]
    (note,) = open_recording(folder).notes()
    assert_words(note, "left.avi", "5 frames", "right.avi", "3", "number 4")


def test_cut_off_video_ends_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = video(tmp_path / "run.avi", 20)
    whole = file.read_bytes()
    frames = [n for n in range(len(whole)) if whole.startswith(b"00dc", n)]
    # The frames from the sixth on are missing, but the header still counts all of them.
    file.write_bytes(whole[: frames[5]])

    harness = replayed(file)

    warnings = [r.message for r in caplog.records if "left out image" in r.message]
    sent = len(harness.take("left_image"))
    assert 1 <= sent <= 6
    if sent < len(open_recording(file).images().stamps):  # type: ignore[union-attr]
        assert f"{file} ends after {sent} of" in warnings[0]


def test_part_of_a_video_is_replayed(tmp_path: Path) -> None:
    file = video(tmp_path / "run.avi", 10)

    harness = replayed(file, begin_s=0.45, end_s=0.75)

    assert [round(shade(image), -1) for image in harness.take("left_image")] == [60, 70, 80]


def test_damaged_image_is_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = save(tmp_path / "images", "0.png", "1.png", "2.png")
    damaged = folder / "1.png"
    damaged.write_bytes(damaged.read_bytes()[:-60])

    harness = replayed(folder, image_rate_hz=5.0)

    assert [shade(image) for image in harness.take("left_image")] == [10, 30]
    assert any(f"left out image 2: {damaged}" in r.message for r in caplog.records)


def test_unpaired_images_are_left_out_and_named(tmp_path: Path) -> None:
    folder = pairs(tmp_path, 4)
    (folder / "right2.png").unlink()
    save(folder, "overview.png")

    recording = open_recording(folder, image_rate_hz=1.0)

    images = recording.images()
    assert images is not None
    assert len(images.stamps) == 3
    (note,) = recording.notes()
    assert_words(note, "2 images", "left2.png, overview.png")


def test_clock_runs_over_the_images(tmp_path: Path) -> None:
    folder = save(tmp_path, *(f"{n}.png" for n in range(11)))
    harness = start(ReplayClock, 50.0, recording=str(folder), image_rate_hz=2.0, rate=10.0)

    harness.run_for(2.0)

    times = [to_ns(m.clock) / SECOND for m in harness.take("time")]
    assert times[-1] - times[0] == pytest.approx(6.0, abs=0.1)
    assert harness.ends


def test_recorded_images_are_shown(tmp_path: Path) -> None:
    folder = pairs(tmp_path, 3)

    answer = cairn("recording", "show", str(folder), "--image-rate", "2")
    drawn = cairn(
        "recording", "show", str(folder), "--image-rate", "2", "--out", str(tmp_path / "x.png")
    )

    assert "image pair 320 x 240      3      1.00       2.00" in answer.out
    assert_words(drawn.err, "neither scans nor odometry", "nothing to draw")


def test_deployment_replays_images_only(tmp_path: Path) -> None:
    folder = pairs(tmp_path / "images", 5)
    recorded = {"recording": str(folder), "image_rate_hz": 5.0}
    file = tmp_path / "replay.yaml"
    file.write_text(
        yaml.safe_dump(
            {
                "cairn": 1,
                "robot": "robot",
                "clock": "simulated",
                "components": {
                    "camera": {
                        "plugin": "replay_camera",
                        "parameters": recorded | calibrations(tmp_path / "calibration"),
                    },
                    "replay_clock": {
                        "plugin": "replay_clock",
                        "parameters": recorded | {"rate": 2.0},
                        "topics": {"time": "clock"},
                        "restart": "transient",
                        "significant": True,
                    },
                },
            }
        )
    )

    topics = {
        "left_image": Image,
        "left_info": CameraInfo,
        "right_image": Image,
        "right_info": CameraInfo,
    }
    with DeploymentHarness(file) as replay:
        readings: dict[str, LockstepReading[Any]] = {
            name: replay.read(name, message) for name, message in topics.items()
        }
        assert replay.run_to_end().normal

    for name, reading in readings.items():
        stamps = [to_ns(message.header.stamp) for message in reading.messages]
        assert stamps == [SECOND + k * SECOND // 5 for k in range(5)], name
