"""Whether two images are a stereo pair at all, where stereo has told no distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cairn.components.object_recognizer.condition import blindness
from cairn.vision.features import Features
from cairn.vision.stereo import StereoRig, disparities, look_swapped

Gray = NDArray[np.uint8]

# Points of the left image that are looked for in the right one.
_PROBES = 100
# Of a pair that is one, more are found than this share: the others are at its edges, or covered.
_FEW = 0.2


def swapped(left: Gray, right: Gray, features: Features, rig: StereoRig) -> bool:
    """Whether the rectified `left` image with these features is the right camera's."""
    return look_swapped(left, right, features.points[:_PROBES], rig)


def unlike(left: Gray, right: Gray, features: Features, rig: StereoRig) -> str:
    """Why rectified images are no pair of one moment, in words; empty if they may well be."""
    points = features.points[:_PROBES]
    most = rig.nearest_disparity(0.3)
    found = np.isfinite(disparities(left, right, points, rig, least=-most, most=most))
    if np.count_nonzero(found) > _FEW * len(points):
        return ""
    blind = blindness(right)
    if blind:
        return f"the right image shows next to nothing ({blind})"
    return (
        "hardly anything of the left image is found again in the right one: are they of one "
        "moment, and by the cameras that were calibrated together?"
    )
