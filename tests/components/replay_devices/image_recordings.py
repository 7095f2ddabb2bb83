"""Folders and videos of identifiable images, and the component that replays them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.replay_devices.camera import ReplayCamera
from cairn.components.replay_devices.open_recording import open_recording
from cairn.vision.camera_file import write_camera
from tests.cairn.vision.cameras import HEIGHT, WIDTH, info
from tests.components.replay_devices.conftest import start

Gray = NDArray[np.uint8]


def numbered_image(shade: int, width: int = WIDTH, height: int = HEIGHT) -> Gray:
    """Return an image that can be identified after compression: its shade is in the middle."""
    image = np.full((height, width), shade, np.uint8)
    image[: height // 4] = 255 - shade
    return image


def shade(image: Any) -> int:
    return int(image.data.reshape(image.height, image.width)[image.height // 2, image.width // 2])


def save(folder: Path, *names: str, start: int = 10, **size: int) -> Path:
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), numbered_image(start + 10 * number, **size))
    return folder


def pairs(folder: Path, count: int) -> Path:
    save(folder, *(f"left{n}.png" for n in range(count)))
    return save(folder, *(f"right{n}.png" for n in range(count)), start=15)


def video(file: Path, count: int, width: int = WIDTH, fps: float = 10.0, start: int = 10) -> Path:
    file.parent.mkdir(exist_ok=True)
    size = (width, HEIGHT)
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(file), codec, fps, size, isColor=False)
    for number in range(count):
        writer.write(numbered_image(start + 10 * number, width))
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


def replayed(path: Path, **parameters: Any) -> Any:
    """Return the component after the whole recording was replayed."""
    first, last = open_recording(path, image_rate_hz=parameters.get("image_rate_hz")).span()
    harness = start(ReplayCamera, first / SECOND - 0.5, recording=str(path), **parameters)
    harness.run_for((last - first) / SECOND + 1.0)
    return harness
