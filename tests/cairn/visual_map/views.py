"""Textured pictures from a seed, and their model views."""

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import extract
from cairn.vision.object_model import ModelView


@cache
def texture(seed: int, width: int = 160, height: int = 120) -> NDArray[np.uint8]:
    """Return a picture with features of all sizes, different for each seed."""
    random = np.random.default_rng(seed)
    picture = np.zeros((height, width))
    for cell in (4, 8, 16, 32):
        coarse = random.normal(0, 1, (height // cell + 1, width // cell + 1))
        picture += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    texture = np.clip(128 + 45 * picture, 0, 255).astype(np.uint8)
    texture.flags.writeable = False
    return texture


@cache
def view(seed: int, width: int = 160, height: int = 120) -> ModelView:
    picture = texture(seed, width, height)
    return ModelView(width, height, extract(picture), picture)
