"""Images of taught pictures in front of something else, with the truth about where they are."""

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import extract, varied
from cairn.vision.recognition import Recognition
from cairn.vision.taught import TaughtObject, View
from tests.cairn.vision.taught_objects import texture

Gray = NDArray[np.uint8]
Homography = NDArray[np.float64]

WIDTH, HEIGHT = 640, 480


def taught(number: int, *pictures: Gray) -> TaughtObject:
    return TaughtObject(number, f"object {number}", None, tuple(view(p) for p in pictures))


def view(picture: Gray) -> View:
    return View(picture.shape[1], picture.shape[0], varied(extract(picture), 400), picture)


def wall(seed: int = 999) -> Gray:
    """A background that is full of features, none of them those of other seeds' textures."""
    return texture(seed, WIDTH, HEIGHT)


def at(x: float, y: float, scale: float = 1.0, turn_deg: float = 0.0) -> Homography:
    """What puts a picture's top left pixel at x, y [px], scaled and turned clockwise."""
    turn = np.deg2rad(turn_deg)
    cosine, sine = scale * np.cos(turn), scale * np.sin(turn)
    return np.array([[cosine, -sine, x], [sine, cosine, y], [0.0, 0.0, 1.0]])


def paste(image: Gray, picture: Gray, homography: Homography) -> Gray:
    """The image with the picture in it."""
    size = (image.shape[1], image.shape[0])
    inside = cv2.warpPerspective(np.full(picture.shape, 255, np.uint8), homography, size)
    warped = cv2.warpPerspective(picture, homography, size)
    return np.where(inside > 127, warped, image).astype(np.uint8)


def corner_error(found: Recognition, picture: Gray, homography: Homography) -> float:
    """How far the farthest corner lies off [px]."""
    right, bottom = picture.shape[1] - 0.5, picture.shape[0] - 0.5
    corners = np.array([[[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]]])
    truth = cv2.perspectiveTransform(corners, homography)[0]
    return float(np.linalg.norm(found.corners - truth, axis=1).max())
