"""Images of known pictures in front of a background, with their true homographies."""

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import extract, select_across_scales
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.vision.recognition import Detection
from tests.cairn.visual_map.views import texture

Gray = NDArray[np.uint8]
Homography = NDArray[np.float64]

WIDTH, HEIGHT = 640, 480


def model(number: int, *pictures: Gray) -> ObjectModel:
    return ObjectModel(number, f"object {number}", None, tuple(view(p) for p in pictures))


def view(picture: Gray) -> ModelView:
    return ModelView(
        picture.shape[1], picture.shape[0], select_across_scales(extract(picture), 400), picture
    )


def wall(seed: int = 999) -> Gray:
    """Return a background full of features that differ from those of other seeds."""
    return texture(seed, WIDTH, HEIGHT)


def at(x: float, y: float, scale: float = 1.0, turn_deg: float = 0.0) -> Homography:
    """Return the homography that puts the top left pixel at x, y [px], scaled and rotated."""
    turn = np.deg2rad(turn_deg)
    cosine, sine = scale * np.cos(turn), scale * np.sin(turn)
    return np.array([[cosine, -sine, x], [sine, cosine, y], [0.0, 0.0, 1.0]])


def paste(image: Gray, picture: Gray, homography: Homography) -> Gray:
    """Return the image with the picture pasted into it."""
    size = (image.shape[1], image.shape[0])
    inside = cv2.warpPerspective(np.full(picture.shape, 255, np.uint8), homography, size)
    warped = cv2.warpPerspective(picture, homography, size)
    return np.where(inside > 127, warped, image).astype(np.uint8)


def corner_error(found: Detection, picture: Gray, homography: Homography) -> float:
    """Return the largest error of a corner [px]."""
    right, bottom = picture.shape[1] - 0.5, picture.shape[0] - 0.5
    corners = np.array([[[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]]])
    truth = cv2.perspectiveTransform(corners, homography)[0]
    return float(np.linalg.norm(found.corners - truth, axis=1).max())
