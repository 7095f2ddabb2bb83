"""Where a recognized object is: by stereo, by its size, and whether the two bear each other out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.object_recognizer.agreement import SYSTEMATIC
from cairn.components.object_recognizer.cameras import Cameras
from cairn.vision.ranging import Located, by_size, by_stereo, fused
from cairn.vision.recognition import Recognition
from cairn.vision.stereo import disparities, rows_off
from cairn.vision.taught import TaughtObject

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]
Way = Literal["stereo", "size", "both", "none"]

APART: Final = 0.25
"""Ranges by stereo and by size that differ by a larger share are of no use."""

# Ranges by stereo and by size that differ by more than so many deviations, and by more than what
# sizes err by anyway, contradict each other.
_DEVIATIONS = 2.5
# Of an object's points more than this share are found in the right image, unless it is covered
# there, or so many rows [px] off.
_MATCHED, _ALIGNED = 0.6, 1.0
# Points that tell how many rows; each takes its time.
_PROBES = 20
# More disparities tell hardly more, but each takes its time.
_MOST_POINTS = 60


@dataclass(frozen=True)
class Sighting:
    """A recognized object and where it is, or why that is not known.

    `located` is in the rectified left optical frame; `way` says by what. `ratio` is the distance
    by stereo over that by size, where there are both; `consistent` is whether the two may be of
    one place, as sure as they are. `doubt` says why `located` is None, or why stereo is not used;
    `rows_off` [px] is then how much lower the right image shows the object, if that is why.
    """

    recognition: Recognition
    located: Located | None
    way: Way
    ratio: float | None = None
    doubt: str = ""
    consistent: bool = True
    rows_off: float = 0.0

    @property
    def by_stereo(self) -> bool:
        """Whether stereo has told a distance."""
        return self.ratio is not None or self.way == "stereo"


def sighted(
    recognition: Recognition,
    known: Mapping[int, TaughtObject],
    cameras: Cameras,
    left: Gray,
    right: Gray | None,
) -> Sighting:
    """Where what was recognized in the rectified `left` image is.

    `right` is the rectified right image, None if there is none.
    """
    taught = known[recognition.object_id]
    view = taught.views[recognition.view]
    middle = _middle(recognition, view.width, view.height)
    size = None
    if taught.size is not None:
        size = by_size(
            recognition.view_points,
            recognition.image_points,
            (view.width, view.height),
            taught.size,
            cameras.rig,
        )
    stereo = None
    if right is not None and cameras.right is not None:
        points = recognition.image_points[:: max(1, recognition.inliers // _MOST_POINTS)]
        found = disparities(left, right, points, cameras.rig)
        off = 0.0
        if np.isfinite(found).mean() < _MATCHED:
            some = points[:: max(1, len(points) // _PROBES)]
            off = rows_off(left, right, some, cameras.rig)
        if abs(off) > _ALIGNED:
            alone = _judged(recognition, taught, None, size, stereo_given=True)
            return replace(alone, doubt=_misaligned(taught, off, alone.doubt), rows_off=off)
        stereo = by_stereo(points, found, middle, cameras.rig)
        if stereo is not None and size is not None and _apart(stereo, size):
            # Of two that look alike one may have been matched with the other.
            expected = cameras.rig.fx * cameras.rig.baseline / float(size.position[2])
            found = disparities(
                left, right, points, cameras.rig,
                least=expected * (1 - APART), most=expected * (1 + APART),
            )  # fmt: skip
            stereo = by_stereo(points, found, middle, cameras.rig) or stereo
    return _judged(recognition, taught, stereo, size, stereo_given=right is not None)


def without_wrong_twins(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Doubts objects of unknown size that are seen more than once, as if of different sizes.

    Stereo has then taken one of them for the other.
    """
    twins: dict[int, list[float]] = {}
    for one in sightings:
        if one.way in ("stereo", "none"):
            twins.setdefault(one.recognition.object_id, []).append(_apparent_size(one))
    wrong = {key for key, sizes in twins.items() if not max(sizes) <= (1 + APART) * min(sizes)}
    return [
        replace(
            one,
            located=None,
            way="none",
            doubt=f"{one.recognition.name}: seen more than once, and stereo takes one for the "
            "other; tell its size",
        )
        if one.way == "stereo" and one.recognition.object_id in wrong
        else one
        for one in sightings
    ]


def _apparent_size(one: Sighting) -> float:
    if one.located is None:
        return math.inf
    area = cv2.contourArea(one.recognition.corners.astype(np.float32))
    return float(one.located.position[2]) * math.sqrt(area)


def _judged(
    recognition: Recognition,
    taught: TaughtObject,
    stereo: Located | None,
    size: Located | None,
    *,
    stereo_given: bool,
) -> Sighting:
    if stereo is None or size is None:
        one = size if stereo is None else stereo
        if one is not None:
            return Sighting(recognition, one, "size" if stereo is None else "stereo")
        why = "its size is not known" if taught.size is None else "its size fits no pose"
        pair = "stereo does not tell" if stereo_given else "there is no stereo"
        doubt = f"{taught.name}: no range, for {why} and {pair}"
        if taught.size is None:
            doubt += f"; tell it by `cairn object teach '{taught.name}' --size W,H`"
        return Sighting(recognition, None, "none", doubt=doubt)
    far, near = (float(np.linalg.norm(one.position)) for one in (stereo, size))
    ratio = far / near
    if _apart(stereo, size):
        doubt = f"{taught.name}: it is at {far:.2f} m by stereo, but at {near:.2f} m by its size"
        return Sighting(recognition, None, "none", ratio, doubt, consistent=False)
    both = fused(stereo, size)
    assert both is not None
    consistent = both.consistent and not _contradict(stereo, size, ratio)
    located = both.located if consistent else _either(stereo, size)
    return Sighting(recognition, located, "both", ratio, consistent=consistent)


def _misaligned(taught: TaughtObject, off: float, doubt: str) -> str:
    told = (
        f"{taught.name}: stereo is not used, for the right image shows it {abs(off):.0f} rows "
        f"{'lower' if off > 0 else 'higher'}: the cameras are not where their calibration has "
        "them; calibrate them anew with `cairn camera calibrate`"
    )
    return "; ".join(filter(None, (told, doubt)))


def _contradict(stereo: Located, size: Located, ratio: float) -> bool:
    ray = size.position / np.linalg.norm(size.position)
    deviation = math.sqrt(float(ray @ (stereo.covariance + size.covariance) @ ray))
    off = abs(ratio - 1.0)
    far = float(np.linalg.norm(size.position))
    return off > SYSTEMATIC and off * far > _DEVIATIONS * deviation


def _apart(one: Located, other: Located) -> bool:
    ratio = float(np.linalg.norm(one.position) / np.linalg.norm(other.position))
    return max(ratio, 1 / ratio) > 1 + APART


def _either(one: Located, other: Located) -> Located:
    """One of the two, but not known which: the mean and covariance of their mixture."""
    off = (one.position - other.position) / 2
    covariance = (one.covariance + other.covariance) / 2 + np.outer(off, off)
    return Located((one.position + other.position) / 2, covariance)


def _middle(recognition: Recognition, width: int, height: int) -> Array:
    middle = np.array([[[(width - 1) / 2, (height - 1) / 2]]])
    return np.asarray(cv2.perspectiveTransform(middle, recognition.homography)[0, 0], np.float64)
