"""Images of bags are replayed as a camera sends them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cairn import SECOND
from cairn.components.replay_devices.open_recording import open_recording
from cairn.errors import RecordingError
from tests.cairn.vision.cameras import HEIGHT, WIDTH
from tests.components.replay_devices.image_recordings import (
    numbered_image,
    replayed,
    shade,
)
from tests.components.replay_devices.test_ros_bag import (
    BEGIN,
    STORE,
    Messages,
    header,
    odometry,
    of,
    ros2,
)
from tests.wording import assert_words, words_in_order

pytestmark = pytest.mark.images


def image(t: float, shade: int, **changes: Any) -> Any:
    fields = {"height": HEIGHT, "width": WIDTH, "encoding": "bgr8", "is_bigendian": 0}
    data = np.repeat(numbered_image(shade).ravel(), 3)
    fields |= {"step": 3 * WIDTH, "data": data, **changes}
    return of(STORE, "sensor_msgs/msg/Image", header=header(t, "camera"), **fields)


def compressed(t: float, shade: int) -> Any:
    data = np.frombuffer(cv2.imencode(".png", numbered_image(shade))[1].tobytes(), np.uint8)
    return of(
        STORE,
        "sensor_msgs/msg/CompressedImage",
        header=header(t, "camera"),
        format="png",
        data=data,
    )


@pytest.mark.parametrize("make", [image, compressed])
def test_images_of_a_bag_are_replayed_in_pairs(
    tmp_path: Path, make: Callable[[float, int], Any]
) -> None:
    kind = "/compressed" if make is compressed else ""
    messages: Messages = []
    for number in range(5):
        t = BEGIN + 0.2 * number
        at = round(t * SECOND)
        if number != 1:
            messages.append((f"/stereo/left/image_raw{kind}", at, make(t, 10 + 10 * number)))
        if number != 2:
            other = make(t + 0.001, 15 + 10 * number)
            messages.append((f"/stereo/right/image_raw{kind}", at + 1, other))
    bag = ros2(tmp_path / "bag", messages)

    harness = replayed(bag)

    assert [shade(m) for m in harness.take("left_image")] == [10, 40, 50]
    assert [shade(m) for m in harness.take("right_image")] == [15, 45, 55]
    assert list(open_recording(bag).span()) == [BEGIN * SECOND, round((BEGIN + 0.8) * SECOND)]


@pytest.mark.parametrize("which", [0, 1])
def test_truncated_compressed_image_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, which: int
) -> None:
    shades = [10, 20, 30]
    messages: Messages = [
        ("/image/compressed", round((BEGIN + 0.2 * k) * SECOND), compressed(BEGIN + 0.2 * k, shade))
        for k, shade in enumerate(shades)
    ]
    messages[which][2].data = messages[which][2].data[:-60]
    bag = ros2(tmp_path / "bag", messages)

    harness = replayed(bag)

    whole = [shade for k, shade in enumerate(shades) if k != which]
    assert [shade(image) for image in harness.take("left_image")] == whole
    why = f"topic /image/compressed, image {which + 1}: it (png): is truncated or damaged"
    assert any(why in record.message for record in caplog.records)


@pytest.mark.parametrize("changes", [{"step": 3 * WIDTH + 1}, {"encoding": "mono64"}])
def test_invalid_image_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, changes: dict[str, Any]
) -> None:
    odd = image(BEGIN + 0.2, 20, **changes)
    messages = [("/image", round(m * SECOND), i) for m, i in (
        (BEGIN, image(BEGIN, 10)), (BEGIN + 0.2, odd), (BEGIN + 0.4, image(BEGIN + 0.4, 30))
    )]  # fmt: skip

    harness = replayed(ros2(tmp_path / "bag", messages))

    assert [shade(image) for image in harness.take("left_image")] == [10, 30]
    assert any("topic /image, image 2: " in record.message for record in caplog.records)


def test_images_with_stamps_of_another_clock_use_times_of_receipt(tmp_path: Path) -> None:
    messages = [("/image", round((BEGIN + k) * SECOND), image(0.5 + k, 10)) for k in range(3)]

    recording = open_recording(ros2(tmp_path / "bag", messages))

    images = recording.images()
    assert images is not None
    assert images.stamps == [round((BEGIN + k) * SECOND) for k in range(3)]
    assert any("/image are from another clock" in note for note in recording.notes())


def test_images_out_of_order_are_left_out(tmp_path: Path) -> None:
    stamps = [0.0, 0.4, 0.2, 0.4, 0.6]
    messages = [
        ("/image", round((BEGIN + k) * SECOND), image(BEGIN + stamp, 10 + 10 * k))
        for k, stamp in enumerate(stamps)
    ]

    recording = open_recording(ros2(tmp_path / "bag", messages))

    images = recording.images()
    assert images is not None
    assert [round(stamp / SECOND - BEGIN, 1) for stamp in images.stamps] == [0.0, 0.4, 0.6]
    assert [int(images.load(k)[0][-1, 0]) for k in range(3)] == [10, 20, 50]
    assert_words(" ".join(recording.notes()), "2 images", "/image", "left out")


def test_bag_of_damaged_images_only_is_rejected(tmp_path: Path) -> None:
    message = compressed(BEGIN, 10)
    message.data = message.data[:-60]
    bag = ros2(tmp_path / "bag", [("/image/compressed", round(BEGIN * SECOND), message)])

    with pytest.raises(RecordingError, match=r"image 1: it \(png\): is truncated or damaged"):
        open_recording(bag).images()


def test_one_of_several_cameras_must_be_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    topics = ("/front/image", "/back/image")
    bag = ros2(
        tmp_path / "bag",
        [(topic, BEGIN * SECOND, image(BEGIN, 30)) for topic in topics]
        + [("/odom", BEGIN * SECOND, odometry(BEGIN, 0.0))],
    )

    nothing = replayed(bag)
    named = replayed(bag, topics={"left_image": "/back/image"})

    assert nothing.take("left_image") == []
    assert any("several topics hold images" in r.message for r in caplog.records)
    assert [shade(m) for m in named.take("left_image")] == [30]
    with pytest.raises(RecordingError, match=words_in_order("/odom", "/back/image")):
        open_recording(bag, topics={"left_image": "/odom"})


def test_recording_without_images_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bag = ros2(tmp_path / "bag", [("/odom", BEGIN * SECOND, odometry(BEGIN, 0.0))])

    assert replayed(bag).take("left_image") == []
    assert any("holds no images of one camera" in r.message for r in caplog.records)
