"""Recordings that cannot be replayed as a camera are rejected with a remedy."""

from pathlib import Path
from typing import Any

import pytest

from cairn import CairnError
from cairn.components.replay_devices.camera import ReplayCamera
from tests.components.replay_devices.conftest import start
from tests.components.replay_devices.image_recordings import calibrations, pairs, save, video

pytestmark = pytest.mark.images


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
    ("what", "message"),
    [
        ("no times", "times .* unknown.* image_rate_hz"),
        ("times run back", r"1.png .* 1.000000 s.* 0.png .* 2.000000 s"),
        ("two at one time", r"b_1700000000123.png has time .* not after a_1700000000123.png"),
        ("too few times", r"times.txt .* 1 times.* 2 images"),
        ("no time", r"times.txt, line 1: soon .* seconds"),
        ("sizes", r"1.png .* 64 x 48 .*0.png .* 320 x 240"),
        ("no image", r"1.png: not an image"),
        ("no pairs", "no left image has a right one"),
        ("calibrated at another size", r"left.yaml .* 320 x 240 .* 640 x 480"),
        ("two calibrations for one camera", "one camera only.* right_cal"),
        ("swapped", "swapped"),
        ("side by side of pairs", "side_by_side = true.* both cameras"),
        ("no video", "run.avi cannot be decoded"),
        ("too many videos", "a.avi, b.avi.* name one"),
        ("videos of two sizes", r"right.avi .* 640 x 240 .*left.avi .* 320 x 240"),
    ],
)
def test_unusable_images_are_rejected(tmp_path: Path, what: str, message: str) -> None:
    path, parameters = broken(tmp_path, what)
    with pytest.raises(CairnError, match=message):
        start(ReplayCamera, 0.0, recording=str(path), **parameters)
