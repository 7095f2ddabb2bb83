"""Images of flat objects in front of a stereo camera, rendered by projection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn import from_ns
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from tests.cairn.visual_map.views import texture

Gray = NDArray[np.uint8]

WIDTH, HEIGHT, FOCAL, BASELINE = 640, 480, 500.0, 0.12
SIZE = (0.4, 0.3)
"""Size of all objects [m]."""


@dataclass(frozen=True)
class Thing:
    """A texture by its seed, its center [m] in the left optical frame, rotated left [rad]."""

    seed: int
    x: float
    z: float
    rotated: float = 0.0
    y: float = 0.0


@cache
def picture_of(seed: int) -> Gray:
    """Return the picture of an object, 1 mm per pixel."""
    picture = texture(seed, 400, 300)
    picture.flags.writeable = False
    return picture


def photograph(things: Sequence[Thing], right: bool = False, noise: int = 0) -> Gray:
    """Return the image of the left or the right camera; `noise` is a seed."""
    random = np.random.default_rng(noise)
    image = _without_noise(tuple(things), right)
    noisy = image + random.normal(0, 1.5, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@cache
def _without_noise(things: tuple[Thing, ...], right: bool) -> NDArray[np.float32]:
    """Render the image without noise, cached."""
    image = cv2.resize(texture(1234, 160, 120), (WIDTH, HEIGHT)).astype(np.float32) * 0.4 + 60
    for thing in sorted(things, key=lambda one: -one.z):
        picture = picture_of(thing.seed)
        across = np.array([math.cos(thing.rotated), 0.0, math.sin(thing.rotated)])
        down = np.array([0.0, 1.0, 0.0])
        middle = np.array([thing.x - (BASELINE if right else 0.0), thing.y, thing.z])
        per_pixel = SIZE[0] / picture.shape[1]
        corner = middle - per_pixel * (199.5 * across + 149.5 * down)
        plane = np.column_stack((per_pixel * across, per_pixel * down, corner))
        camera = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
        # Rendered at twice the resolution, so that far objects are as smooth as in a camera.
        fine = np.diag([2.0, 2.0, 1.0])
        fine[:2, 2] = 0.5
        size = (2 * WIDTH, 2 * HEIGHT)
        rendered = cv2.warpPerspective(picture, fine @ camera @ plane, size)
        mask = cv2.warpPerspective(np.ones_like(picture), fine @ camera @ plane, size)
        small = cv2.resize(rendered, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        there = cv2.resize(mask.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        image = image * (1 - there) + small * there
    image.flags.writeable = False
    return image


def pair(things: Sequence[Thing], noise: int = 0) -> tuple[Gray, Gray]:
    """Return the images of both cameras."""
    return photograph(things, noise=2 * noise), photograph(things, right=True, noise=2 * noise + 1)


def info(right: bool = False, baseline: float = BASELINE, focal: float = FOCAL) -> CameraInfo:
    """Return the CameraInfo of a camera."""
    k = np.array([focal, 0, WIDTH / 2, 0, focal, HEIGHT / 2, 0, 0, 1])
    p = np.array([focal, 0, WIDTH / 2, 0, 0, focal, HEIGHT / 2, 0, 0, 0, 1, 0], np.float64)
    if right:
        p[3] = -focal * baseline
    side = "right" if right else "left"
    return CameraInfo(
        header=Header(frame_id=f"{side}_camera_optical_frame"),
        width=WIDTH,
        height=HEIGHT,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=p,
    )


def message(gray: NDArray[np.generic], stamp_s: float, encoding: str = "mono8") -> Image:
    """Return an image message as a driver publishes it."""
    rows = np.ascontiguousarray(gray).view(np.uint8).reshape(gray.shape[0], -1)
    return Image(
        header=Header(stamp=from_ns(round(stamp_s * 1e9)), frame_id="left_camera_optical_frame"),
        height=gray.shape[0],
        width=gray.shape[1],
        encoding=encoding,
        step=rows.shape[1],
        data=rows.ravel(),
    )
