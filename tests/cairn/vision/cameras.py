"""Synthetic calibrated cameras and stereo images for tests."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cairn.schemas.sensor_msgs import CameraInfo
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

WIDTH, HEIGHT, FOCAL, BASELINE = 320, 240, 250.0, 0.1
CX, CY = 159.5, 119.5


def info(side: str = "left", **changes: Any) -> CameraInfo:
    """Return a camera without distortion, whose images are already rectified."""
    tx = -FOCAL * BASELINE if side == "right" else 0.0
    fields: dict[str, Any] = {
        "header": Header(frame_id=f"{side}_camera_optical_frame"),
        "width": WIDTH,
        "height": HEIGHT,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": np.array([FOCAL, 0, CX, 0, FOCAL, CY, 0, 0, 1.0]),
        "r": np.eye(3).ravel(),
        "p": np.array([FOCAL, 0, CX, tx, 0, FOCAL, CY, 0, 0, 0, 1.0, 0]),
    }
    return CameraInfo(**fields | changes)


def projection(fx: float = FOCAL, cx: float = CX, cy: float = CY, tx: float = 0.0) -> Array:
    return np.array([fx, 0, cx, tx, 0, fx, cy, 0, 0, 0, 1.0, 0])


def pattern(seed: int, columns: Array, rows: Array, finest: float = 5.0) -> Array:
    """Return a texture (0 to 255) at any coordinates [px], also between pixels."""
    random = np.random.default_rng(seed)
    # Single precision suffices for gray levels, and takes a quarter of the time.
    columns, rows = columns.astype(np.float32), rows.astype(np.float32)
    value = np.zeros_like(columns)
    for _ in range(40):
        length, way, phase = random.uniform(finest, 40), *random.uniform(0, 2 * np.pi, 2)
        along, across = 2 * math.pi * np.array((math.cos(way), math.sin(way))) / length
        value += np.sin(np.float32(along) * columns + np.float32(across) * rows + np.float32(phase))
    return np.clip(128 + 18 * value.astype(np.float64), 0, 255)


def plane_pair(seed: int, plane: tuple[float, float, float], noise: float = 0.0) -> list[Gray]:
    """Return left and right images of a plane with disparity c + a * u + b * v [px]."""
    c, a, b = plane
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    # A point at x in the right image is at u = x + disparity(u, v) in the left one.
    left_columns = (columns + c + b * rows) / (1 - a)
    random = np.random.default_rng(seed)
    return [
        np.clip(np.rint(image + random.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)
        for image in (pattern(seed, columns, rows), pattern(seed, left_columns, rows))
    ]
