"""Images of folders, videos and bags are replayed as a camera sends them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from cairn.bus.qos import Qos
from cairn.clock import SECOND, to_ns
from cairn.deployment.load import load_deployment
from cairn.errors import CairnError
from cairn.placement.lockstep_run import LockstepRun
from components.replay.camera import ReplayCamera
from components.replay.clock import ReplayClock
from components.replay.formats import open_recording
from components.replay.recording import RecordingError
from schemas.sensor_msgs import CameraInfo, Image
from tests.commands import cairn
from tests.components.replay.test_bags import BEGIN, STORE, Messages, header, odometry, of, ros2
from tests.vision.cameras import HEIGHT, WIDTH, info
from vision.camera_file import write_camera

StageOf = Callable[..., Any]
MANY = Qos("reliable", "transient_local", 100_000)
Grey = NDArray[np.uint8]


def picture(shade: int, width: int = WIDTH, height: int = HEIGHT) -> Grey:
    """An image that is told from others after compression, too: its shade is in the middle."""
    image = np.full((height, width), shade, np.uint8)
    image[: height // 4] = 255 - shade
    return image


def shade(image: Any) -> int:
    return int(image.data.reshape(image.height, image.width)[image.height // 2, image.width // 2])


def save(folder: Path, *names: str, begin: int = 10, **size: int) -> Path:
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), picture(begin + 10 * number, **size))
    return folder


def pairs(folder: Path, count: int) -> Path:
    save(folder, *(f"left{n}.png" for n in range(count)))
    return save(folder, *(f"right{n}.png" for n in range(count)), begin=15)


def video(file: Path, count: int, width: int = WIDTH, fps: float = 10.0, begin: int = 10) -> Path:
    file.parent.mkdir(exist_ok=True)
    size = (width, HEIGHT)
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(file), codec, fps, size, isColor=False)
    for number in range(count):
        writer.write(picture(begin + 10 * number, width))
    writer.release()
    return file


def calibrations(folder: Path) -> dict[str, str]:
    folder.mkdir(exist_ok=True)
    files = {}
    for side in ("left", "right"):
        file = folder / f"{side}.yaml"
        write_camera(file, info(side), side)
        files[f"{side}_calibration"] = str(file)
    return files


def replayed(stage: StageOf, path: Path, **parameters: Any) -> Any:
    """The driver after all that is recorded has passed."""
    first, last = open_recording(path, image_rate_hz=parameters.get("image_rate_hz")).span()
    it = stage(ReplayCamera, first / SECOND - 0.5, recording=str(path), **parameters).begin()
    it.wait((last - first) / SECOND + 1.0)
    return it


def test_a_folder_of_pairs_is_a_stereo_camera(stage: StageOf, tmp_path: Path) -> None:
    folder = pairs(tmp_path / "images", 12)

    it = replayed(stage, folder, image_rate_hz=5.0, **calibrations(tmp_path / "calibration"))

    left, right = it.taken("left_image"), it.taken("right_image")
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
    infos = it.taken("left_info"), it.taken("right_info")
    for messages in (right, *infos):
        assert [to_ns(message.header.stamp) for message in messages] == stamps
    assert infos[1][0].p.tolist() == info("right").p.tolist()
    assert infos[1][0].header.frame_id == "right_camera_optical_frame"


def test_folders_of_two_numbered_cameras_are_a_stereo_camera(
    stage: StageOf, tmp_path: Path
) -> None:
    save(tmp_path, "cam0/1.png", "cam0/2.png", "cam1/1.png", "cam1/2.png")

    it = replayed(stage, tmp_path, image_rate_hz=5.0)

    assert [shade(image) for image in it.taken("left_image")] == [10, 20]
    assert [shade(image) for image in it.taken("right_image")] == [30, 40]


def test_images_of_one_camera_go_out_on_the_left(stage: StageOf, tmp_path: Path) -> None:
    folder = save(tmp_path / "mono", "a1.png", "a2.png", "a10.png")

    it = replayed(stage, folder, image_rate_hz=1.0)

    assert [shade(image) for image in it.taken("left_image")] == [10, 20, 30]
    # As ROS has it, a camera that is not calibrated tells its size alone.
    told = it.taken("left_info")[0]
    assert (told.width, told.height, told.k.any()) == (WIDTH, HEIGHT, False)
    assert it.taken("right_image") == it.taken("right_info") == []


def test_side_by_side_images_are_parted(stage: StageOf, tmp_path: Path) -> None:
    wide = np.hstack((picture(40), picture(90)))
    (tmp_path / "wide").mkdir()
    cv2.imwrite(str(tmp_path / "wide" / "0.png"), wide)

    it = replayed(
        stage, tmp_path / "wide", image_rate_hz=1.0, side_by_side=True,
        **calibrations(tmp_path / "calibration"),
    )  # fmt: skip

    (left,), (right,) = it.taken("left_image"), it.taken("right_image")
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
def test_times_are_those_of_names_or_of_a_table(
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


def test_a_pairs_folder_beside_a_table_of_names_is_told_the_same(tmp_path: Path) -> None:
    save(tmp_path, "left/0.png", "left/1.png", "right/0.png", "right/1.png")
    (tmp_path / "times.txt").write_text("1.0\n2.0\n")

    images = open_recording(tmp_path).images()

    assert images is not None
    assert (images.cameras, list(images.stamps)) == (2, [SECOND, 2 * SECOND])


def test_a_video_is_replayed_at_its_own_rate_or_at_another(stage: StageOf, tmp_path: Path) -> None:
    file = video(tmp_path / "run.avi", 5, fps=10.0)

    own = replayed(stage, file).taken("left_image")
    slow = replayed(stage, file, image_rate_hz=2.0).taken("left_image")

    assert [round(shade(image), -1) for image in own] == [10, 20, 30, 40, 50]
    for taken, rate in ((own, 10), (slow, 2)):
        assert set(np.diff([to_ns(image.header.stamp) for image in taken])) == {SECOND // rate}


def test_videos_of_both_cameras_are_a_stereo_camera(stage: StageOf, tmp_path: Path) -> None:
    folder = tmp_path / "videos"
    video(folder / "left.avi", 5)
    video(folder / "right.avi", 3, begin=60)

    it = replayed(stage, folder)

    left, right = it.taken("left_image"), it.taken("right_image")
    assert [round(shade(image), -1) for image in left] == [10, 20, 30]
    assert [round(shade(image), -1) for image in right] == [60, 70, 80]
    (note,) = open_recording(folder).notes()
    assert note == "left.avi has 5 frames, right.avi 3: those from number 4 on are left out"


def test_a_video_that_was_cut_off_ends_with_a_warning(
    stage: StageOf, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = video(tmp_path / "run.avi", 20)
    whole = file.read_bytes()
    frames = [n for n in range(len(whole)) if whole.startswith(b"00dc", n)]
    # The frames from the sixth on are gone, the header still tells of all.
    file.write_bytes(whole[: frames[5]])

    it = replayed(stage, file)

    told = [r.message for r in caplog.records if "is left out" in r.message]
    sent = len(it.taken("left_image"))
    assert 1 <= sent <= 6
    if sent < len(open_recording(file).images().stamps):  # type: ignore[union-attr]
        assert f"{file} ends after {sent} of" in told[0]


def test_a_part_of_a_video_is_replayed(stage: StageOf, tmp_path: Path) -> None:
    file = video(tmp_path / "run.avi", 10)

    it = replayed(stage, file, begin_s=0.45, end_s=0.75)

    assert [round(shade(image), -1) for image in it.taken("left_image")] == [60, 70, 80]


def test_an_image_that_is_damaged_is_left_out_with_a_warning(
    stage: StageOf, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = save(tmp_path / "images", "0.png", "1.png", "2.png")
    damaged = folder / "1.png"
    damaged.write_bytes(damaged.read_bytes()[:-60])

    it = replayed(stage, folder, image_rate_hz=5.0)

    assert [shade(image) for image in it.taken("left_image")] == [10, 30]
    assert any(f"image 2 is left out: {damaged}" in r.message for r in caplog.records)


def test_images_without_their_other_are_left_out_and_named(tmp_path: Path) -> None:
    folder = pairs(tmp_path, 4)
    (folder / "right2.png").unlink()
    save(folder, "overview.png")

    recording = open_recording(folder, image_rate_hz=1.0)

    images = recording.images()
    assert images is not None
    assert len(images.stamps) == 3
    (note,) = recording.notes()
    assert note == "2 images have no other of a pair, left out: left2.png, overview.png"


def image(t: float, shade: int, **changes: Any) -> Any:
    told = {"height": HEIGHT, "width": WIDTH, "encoding": "bgr8", "is_bigendian": 0}
    data = np.repeat(picture(shade).ravel(), 3)
    told |= {"step": 3 * WIDTH, "data": data, **changes}
    return of(STORE, "sensor_msgs/msg/Image", header=header(t, "camera"), **told)


def compressed(t: float, shade: int) -> Any:
    data = np.frombuffer(cv2.imencode(".png", picture(shade))[1].tobytes(), np.uint8)
    return of(
        STORE,
        "sensor_msgs/msg/CompressedImage",
        header=header(t, "camera"),
        format="png",
        data=data,
    )


@pytest.mark.parametrize("make", [image, compressed])
def test_images_of_a_bag_are_replayed_in_pairs(
    stage: StageOf, tmp_path: Path, make: Callable[[float, int], Any]
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

    it = replayed(stage, bag)

    assert [shade(m) for m in it.taken("left_image")] == [10, 40, 50]
    assert [shade(m) for m in it.taken("right_image")] == [15, 45, 55]
    assert list(open_recording(bag).span()) == [BEGIN * SECOND, round((BEGIN + 0.8) * SECOND)]


def test_a_bag_with_several_cameras_wants_one_named(
    stage: StageOf, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    topics = ("/front/image", "/back/image")
    bag = ros2(
        tmp_path / "bag",
        [(topic, BEGIN * SECOND, image(BEGIN, 30)) for topic in topics]
        + [("/odom", BEGIN * SECOND, odometry(BEGIN, 0.0))],
    )

    nothing = replayed(stage, bag)
    named = replayed(stage, bag, topics={"left_image": "/back/image"})

    assert nothing.taken("left_image") == []
    assert any("several topics hold images" in r.message for r in caplog.records)
    assert [shade(m) for m in named.taken("left_image")] == [30]
    with pytest.raises(RecordingError, match="/odom is no topic of images; there are /back/image"):
        open_recording(bag, topics={"left_image": "/odom"})


def test_a_recording_without_images_is_told(
    stage: StageOf, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bag = ros2(tmp_path / "bag", [("/odom", BEGIN * SECOND, odometry(BEGIN, 0.0))])

    assert replayed(stage, bag).taken("left_image") == []
    assert any("holds no images of one camera" in r.message for r in caplog.records)


def broken(tmp_path: Path, what: str) -> tuple[Path, dict[str, Any]]:
    """A recording that cannot be replayed, and the driver's parameters."""
    folder = tmp_path / "images"
    known = calibrations(tmp_path / "calibration")
    rate = {"image_rate_hz": 1.0}
    match what:
        case "no times":
            return save(folder, "0.png"), {}
        case "times run back":
            save(folder, "0.png", "1.png")
            (folder / "times.txt").write_text("2.0\n1.0\n")
            return folder, {}
        case "two at one time":
            return save(folder, "a_1700000000123.png", "b_1700000000123.png"), {}
        case "too few times":
            save(folder, "0.png", "1.png")
            (folder / "times.txt").write_text("2.0\n")
            return folder, {}
        case "no time":
            save(folder, "0.png")
            (folder / "times.txt").write_text("soon\n")
            return folder, {}
        case "sizes":
            save(folder, "0.png")
            save(folder, "1.png", width=64, height=48)
            return folder, rate
        case "no image":
            save(folder, "0.png")
            (folder / "1.png").write_text("no image")
            return folder, rate
        case "no pairs":
            return save(folder, "left1.png", "right2.png"), rate
        case "calibrated at another size":
            left = {"left_calibration": known["left_calibration"]}
            return save(folder, "0.png", width=640, height=480), left | rate
        case "two calibrations for one camera":
            return save(folder, "0.png"), known | rate
        case "swapped":
            swapped = {
                "left_calibration": known["right_calibration"],
                "right_calibration": known["left_calibration"],
            }
            return pairs(folder, 2), swapped | rate
        case "side by side of pairs":
            return pairs(folder, 2), {"side_by_side": True} | rate
        case "no video":
            folder.mkdir()
            (folder / "run.avi").write_bytes(b"RIFF\0\0\0\0AVI LIST" + bytes(200))
            return folder / "run.avi", {}
        case "too many videos":
            for name in ("a", "b"):
                video(folder / f"{name}.avi", 2)
            return folder, {}
        case "videos of two sizes":
            video(folder / "left.avi", 2)
            video(folder / "right.avi", 2, width=640)
            return folder, {}
    raise AssertionError(what)


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("no times", "nothing tells when its images were taken: give image_rate_hz"),
        ("times run back", r"1.png was taken at 1.000000 s, not after 0.png, at 2.000000 s"),
        ("two at one time", r"b_1700000000123.png was taken at .* not after a_1700000000123.png"),
        ("too few times", r"times.txt has 1 times, but there are 2 images"),
        ("no time", r"times.txt, line 1: soon is no time in seconds"),
        ("sizes", r"1.png is 64 x 48 pixels, but .*0.png is 320 x 240"),
        ("no image", r"1.png cannot be read as an image"),
        ("no pairs", "no left image belongs to a right one"),
        ("calibrated at another size", r"left.yaml is of images of 320 x 240 .* are 640 x 480"),
        ("two calibrations for one camera", "holds images of one camera only, but right_cal"),
        ("swapped", "left and right are swapped"),
        ("side by side of pairs", "side_by_side = true, but there are images of both cameras"),
        ("no video", "run.avi cannot be decoded"),
        ("too many videos", "holds the videos a.avi, b.avi: name one of them"),
        ("videos of two sizes", r"right.avi is 640 x 240 pixels, but .*left.avi is 320 x 240"),
    ],
)
def test_what_cannot_be_replayed_is_refused(
    stage: StageOf, tmp_path: Path, what: str, told: str
) -> None:
    path, parameters = broken(tmp_path, what)
    it = stage(ReplayCamera, 0.0, recording=str(path), **parameters)

    with pytest.raises(CairnError, match=told):
        it.runtime.component.on_configure()


def test_the_clock_runs_over_the_images(stage: StageOf, tmp_path: Path) -> None:
    folder = save(tmp_path, *(f"{n}.png" for n in range(11)))
    it = stage(ReplayClock, 50.0, recording=str(folder), image_rate_hz=2.0, rate=10.0).begin()

    it.wait(2.0)

    times = [to_ns(m.clock) / SECOND for m in it.taken("time")]
    assert times[-1] - times[0] == pytest.approx(6.0, abs=0.1)
    assert it.ends


def test_what_a_camera_recorded_is_shown(tmp_path: Path) -> None:
    folder = pairs(tmp_path, 3)

    answer = cairn("recording", "show", str(folder), "--image-rate", "2")
    drawn = cairn(
        "recording", "show", str(folder), "--image-rate", "2", "--out", str(tmp_path / "x.png")
    )

    assert "image pair 320 x 240      3      1.00       2.00" in answer.out
    assert "holds neither scans nor odometry: there is nothing to draw" in drawn.err


def test_images_alone_are_replayed_by_a_deployment(tmp_path: Path) -> None:
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

    run = LockstepRun(load_deployment(file), seed=0)
    outside = run.bus.node("/robot/outside", pytest.fail)
    topics = {
        "left_image": Image,
        "left_info": CameraInfo,
        "right_image": Image,
        "right_info": CameraInfo,
    }
    readers = {
        name: outside.subscribe(f"/robot/{name}", kind, MANY, lambda: None)
        for name, kind in topics.items()
    }

    assert run.run(lambda: None).normal

    for name, reader in readers.items():
        stamps = []
        while (message := reader.take()) is not None:
            stamps.append(to_ns(message.header.stamp))
        assert stamps == [SECOND + k * SECOND // 5 for k in range(5)], name
