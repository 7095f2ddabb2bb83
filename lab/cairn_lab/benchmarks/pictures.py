"""Pictures to teach and images to find them in: drawn at random, and cut from real photographs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
Homography = NDArray[np.float64]

WIDTH, HEIGHT = 640, 480
_DATA = Path(__file__).parents[3] / "tests" / "data"
_CUT = ("images/box_in_scene.png", "images/board.jpg", "images/building.jpg", "images/graf1.jpg")
_BEHIND = ("stereo/aloeL.jpg", "images/home.jpg", "images/tsukuba_l.png", "images/blox.jpg")
_CELL = (100, 120)  # px, rows and columns of the cuts from photographs
_PLAIN = 25.0  # gray levels, standard deviation: sky and walls are not taught


@dataclass(frozen=True)
class Scenery:
    """How pictures appear: bounds of scale and tilt [deg], and the effects of the camera."""

    scale: tuple[float, float] = (0.6, 1.6)
    tilt_deg: tuple[float, float] = (0.0, 50.0)
    noise: float = 4.0  # gray levels
    blur: float = 0.7  # px
    covered: float = 0.0  # share of the picture


def read(name: str) -> Gray:
    """Read a photograph of the tests' data."""
    image = cv2.imread(str(_DATA / name), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(_DATA / name)
    return image.astype(np.uint8, copy=False)


def pictures(count: int, seed: int) -> list[Gray]:
    """Return different pictures: all cuts from photographs, the rest drawn."""
    random = np.random.default_rng(seed)
    cuts = [
        cv2.resize(cell, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC).astype(np.uint8)
        for photograph in map(read, _CUT)
        for row in range(0, photograph.shape[0] - _CELL[0] + 1, _CELL[0])
        for column in range(0, photograph.shape[1] - _CELL[1] + 1, _CELL[1])
        if (cell := photograph[row : row + _CELL[0], column : column + _CELL[1]]).std() > _PLAIN
    ]
    drawn = [drawing(random) for _ in range(count - len(cuts))]
    mixed = [*cuts, *drawn]
    return [mixed[i] for i in random.permutation(len(mixed))][:count]


def drawing(random: np.random.Generator) -> Gray:
    """Draw shapes, letters and grain on a smooth background."""
    width, height = (int(side) for side in random.integers(140, 260, 2))
    coarse = random.normal(0, random.uniform(5, 40), random.integers(2, 8, 2))
    ground = random.integers(30, 226) + cv2.resize(
        coarse, (width, height), interpolation=cv2.INTER_CUBIC
    )
    picture = np.clip(ground, 0, 255).astype(np.uint8)
    for _ in range(random.integers(15, 45)):
        _draw(picture, random)
    grain = cv2.GaussianBlur(random.normal(0, 1, picture.shape), (0, 0), random.uniform(0.6, 3.0))
    grain *= random.uniform(2, 15) / grain.std()
    smooth = cv2.GaussianBlur(picture, (0, 0), 0.6).astype(np.float64)
    drawn: Gray = np.clip(smooth + grain, 0, 255).astype(np.uint8)
    return drawn


def _draw(picture: Gray, random: np.random.Generator) -> None:
    height, width = picture.shape
    position = (int(random.integers(0, width)), int(random.integers(0, height)))
    gray, thickness = int(random.integers(0, 256)), int(random.integers(1, 5))
    match random.integers(0, 4):
        case 0:
            axes = (int(random.integers(3, 40)), int(random.integers(3, 40)))
            filled = -1 if random.random() < 0.4 else thickness
            turn, arc = float(random.uniform(0, 360)), float(random.uniform(90, 360))
            cv2.ellipse(picture, position, axes, turn, 0, arc, gray, filled, cv2.LINE_AA)
        case 1:
            corners = position + random.integers(-30, 31, (int(random.integers(3, 7)), 2))
            cv2.fillPoly(picture, [corners.astype(np.int32)], gray, cv2.LINE_AA)
        case 2:
            end = (int(random.integers(0, width)), int(random.integers(0, height)))
            cv2.line(picture, position, end, gray, thickness, cv2.LINE_AA)
        case _:
            text = "".join(chr(random.integers(48, 123)) for _ in range(random.integers(1, 9)))
            font, size = int(random.integers(0, 8)), float(random.uniform(0.4, 2.0))
            cv2.putText(picture, text, position, font, size, gray, thickness, cv2.LINE_AA)


def behind(random: np.random.Generator) -> Gray:
    """Return a background photograph, randomly mirrored and framed; no cut comes from it."""
    photograph = read(_BEHIND[random.integers(len(_BEHIND))])
    share = random.uniform(0.7, 1.0)
    rows, columns = (int(side * share) for side in photograph.shape)
    top = random.integers(0, photograph.shape[0] - rows + 1)
    left = random.integers(0, photograph.shape[1] - columns + 1)
    part = photograph[top : top + rows, left : left + columns]
    if random.random() < 0.5:
        part = part[:, ::-1]
    return cv2.resize(
        np.ascontiguousarray(part), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
    ).astype(np.uint8, copy=False)


def seen(picture: Gray, scenery: Scenery, random: np.random.Generator) -> Homography:
    """Return the homography of a picture at a random pose before a pinhole camera of 60 degrees."""
    height, width = picture.shape
    focal = WIDTH / 2 / math.tan(math.radians(30))
    azimuth, roll = random.uniform(-math.pi, math.pi, 2)
    tilt = math.radians(random.uniform(*scenery.tilt_deg))
    axis = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    turn = cv2.Rodrigues(axis * tilt)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    away = focal / math.exp(random.uniform(*np.log(scenery.scale)))
    middle = random.uniform((0.3 * WIDTH, 0.3 * HEIGHT), (0.7 * WIDTH, 0.7 * HEIGHT))
    position = np.append((middle - (WIDTH / 2, HEIGHT / 2)) / focal, 1.0) * away
    camera = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    centered = np.array([[1, 0, -(width - 1) / 2], [0, 1, -(height - 1) / 2], [0, 0, 1]])
    homography = camera @ np.column_stack((turn[:, 0], turn[:, 1], position)) @ centered
    return np.asarray(homography / homography[2, 2])


def hung(image: Gray, picture: Gray, homography: Homography, covered: float = 0.0) -> Gray:
    """Return the image with the picture in it, a share of the picture covered from one side."""
    height, width = picture.shape
    # A smaller picture loses details finer than the pixels of the image.
    shrunk = math.sqrt(abs(np.linalg.det(homography[:2, :2])))
    if shrunk < 0.8:
        picture = cv2.GaussianBlur(picture, (0, 0), 0.4 / shrunk).astype(np.uint8)
    there = np.full((height, width), 255, np.uint8)
    there[:, : round(covered * width)] = 0
    mask = cv2.warpPerspective(there, homography, (WIDTH, HEIGHT)) / 255.0
    warped = cv2.warpPerspective(picture, homography, (WIDTH, HEIGHT))
    return (image * (1.0 - mask) + warped * mask).astype(np.uint8)


def photographed(image: Gray, scenery: Scenery, random: np.random.Generator) -> Gray:
    """Return the image in other light, blurred, and with noise."""
    light = 255.0 * random.uniform(0.6, 1.3) * (image / 255.0) ** random.uniform(0.7, 1.4)
    blurred = cv2.GaussianBlur(light, (0, 0), scenery.blur)
    noise = random.normal(0.0, scenery.noise, image.shape)
    return np.clip(blurred + noise, 0, 255).astype(np.uint8)
