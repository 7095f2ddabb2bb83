"""Objects to teach: textured pictures from a seed."""

import cv2
import numpy as np
from numpy.typing import NDArray

from vision.features import extract
from vision.taught import View


def texture(seed: int, width: int = 160, height: int = 120) -> NDArray[np.uint8]:
    """A picture with many features, another one for each seed."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (height // 8, width // 8), np.uint8)
    picture = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(40):
        x, y = int(random.integers(width)), int(random.integers(height))
        shade, radius = int(random.integers(256)), int(random.integers(2, 12))
        cv2.circle(picture, (x, y), radius, shade, -1)
    return np.asarray(picture, np.uint8)


def view(seed: int, width: int = 160, height: int = 120) -> View:
    picture = texture(seed, width, height)
    return View(width, height, extract(picture), picture)
