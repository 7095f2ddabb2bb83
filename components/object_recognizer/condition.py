"""Whether an image shows anything, and whether it is a new one."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.schemas.sensor_msgs import Image
from cairn.vision.features import Features

# Gray levels that nearly all pixels of an image in the dark, or into a lamp, are below, or above.
_DARK, _BRIGHT = 40, 215
_NEARLY_ALL: Final = 95.0  # [%]
# An image with fewer features shows next to nothing, an object among it or not.
_FEW = 25


def blindness(gray: NDArray[np.uint8]) -> str:
    """Why the camera sees nothing; empty if it does."""
    sample = gray[::4, ::4]
    if np.percentile(sample, _NEARLY_ALL) < _DARK:
        return "it is too dark"
    if np.percentile(sample, 100 - _NEARLY_ALL) > _BRIGHT:
        return "it is too bright"
    return ""


def shows_little(features: Features) -> bool:
    """Whether hardly anything is in an image: before a blank wall, or with the lens covered."""
    return len(features) < _FEW


class Standstill:
    """Tells when a camera sends the same image again: noise makes no two alike."""

    def __init__(self) -> None:
        self._last: Image | None = None
        self._since_ns = 0
        self._same = False

    @property
    def lasts(self) -> bool:
        """Whether the newest image was the same as the one before."""
        return self._same

    def lasts_ns(self, image: Image, now_ns: int) -> int | None:
        """How long the image has been the same, bit for bit; None if it is another one."""
        last, self._last = self._last, image
        self._same = same = (
            last is not None
            and (last.width, last.height, last.encoding)
            == (image.width, image.height, image.encoding)
            and np.array_equal(last.data, image.data)
        )
        if not same or now_ns < self._since_ns:
            self._since_ns = now_ns
        return now_ns - self._since_ns if same else None
