"""Turns detections into observations: range and bearing from the robot, by stereo and by size."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.object_recognizer.cameras import Cameras
from cairn.schemas.cairn_msgs import RecognizedObject
from cairn.vision.object_model import ObjectModel
from cairn.vision.ranging import (
    CameraPosition,
    consistent,
    fuse,
    range_by_size,
    range_by_stereo,
)
from cairn.vision.recognition import Detection, RangingMethod
from cairn.vision.stereo import StereoRig, disparities, rows_off

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]
Pose = tuple[float, float, float]

MOST_DISAGREEMENT: Final = 0.25
"""Ranges by stereo and by size that differ by a larger share are both rejected."""

SYSTEMATIC: Final = 0.08
"""Relative error of sizes and photographs that always remains."""

# Ranges by stereo and by size contradict each other if they differ by more than this many standard
# deviations, and by more than the systematic error of sizes.
_DEVIATIONS = 2.5
# Least share of an object's points with a disparity, unless the object is covered in the right
# image or vertically displaced; and largest vertical displacement of an aligned pair [px].
_MATCHED, _ALIGNED = 0.6, 1.0
# Points that measure the vertical displacement, and points that measure disparities, at most: each
# takes time, and more hardly improve the result.
_ROW_PROBES, _MOST_POINTS = 20, 60
# Ratios of ranges that are remembered, and least number of one object for a conclusion.
_WINDOW, _LEAST = 60, 8
# An object whose center is nearer to the image's edge than this share of the width is incomplete.
_EDGE = 0.1
# Margin of the range limits within which an object is certainly recognized, as a share.
_RANGE_MARGIN = 0.1
_STEPS = 12


@dataclass(frozen=True)
class FieldOfView:
    """Where objects can be recognized: bearings [rad, left positive] and ranges [m]."""

    right: float = 0.0
    left: float = 0.0
    nearest: float = 0.0
    farthest: float = 0.0


NO_VIEW = FieldOfView()


def measure_range(
    detection: Detection,
    models: Mapping[int, ObjectModel],
    cameras: Cameras,
    left: Gray,
    right: Gray | None,
) -> Detection:
    """Return a detection in the rectified `left` image with the position of its object.

    `right` is the rectified right image, None for a single camera.
    """
    model = models[detection.object_id]
    view = model.views[detection.view]
    middle = _center(detection, view.width, view.height)
    size = None
    if model.size is not None:
        size = range_by_size(
            detection.view_points,
            detection.image_points,
            (view.width, view.height),
            model.size,
            cameras.rig,
        )
    stereo = None
    if right is not None and cameras.right is not None:
        points = detection.image_points[:: max(1, detection.inliers // _MOST_POINTS)]
        found = disparities(left, right, points, cameras.rig)
        off = 0.0
        if np.isfinite(found).mean() < _MATCHED:
            probes = points[:: max(1, len(points) // _ROW_PROBES)]
            off = rows_off(left, right, probes, cameras.rig)
        if abs(off) > _ALIGNED:
            by_size = _combine(detection, model, None, size, has_stereo=True)
            warning = _misalignment_warning(model, off, by_size.warning)
            return replace(by_size, warning=warning, rows_off=off)
        stereo = range_by_stereo(points, found, middle, cameras.rig)
        if stereo is not None and size is not None and _disagree(stereo, size):
            # Of two identical objects, one may have been matched with the other.
            expected = cameras.rig.fx * cameras.rig.baseline / float(size.position[2])
            found = disparities(
                left, right, points, cameras.rig,
                least=expected * (1 - MOST_DISAGREEMENT), most=expected * (1 + MOST_DISAGREEMENT),
            )  # fmt: skip
            stereo = range_by_stereo(points, found, middle, cameras.rig) or stereo
    return _combine(detection, model, stereo, size, has_stereo=right is not None)


def reject_mixed_up_twins(detections: Sequence[Detection]) -> list[Detection]:
    """Reject stereo positions of identical objects of unknown size that seem to differ in size.

    Then stereo has matched one of them with the other.
    """
    sizes: dict[int, list[float]] = {}
    for one in detections:
        if one.ranged_by in ("stereo", "none"):
            sizes.setdefault(one.object_id, []).append(_apparent_size(one))
    wrong = {
        key for key, each in sizes.items() if not max(each) <= (1 + MOST_DISAGREEMENT) * min(each)
    }
    return [
        replace(
            one,
            position=None,
            ranged_by="none",
            warning=f"{one.name}: several are visible, and stereo matches one with "
            "another; give its size",
        )
        if one.ranged_by == "stereo" and one.object_id in wrong
        else one
        for one in detections
    ]


def make_observation(
    detection: Detection, mount: Pose, bearing_sd: float = 0.0
) -> RecognizedObject | None:
    """Return the observation of a detected object; None if its position is unknown.

    Range and bearing are from the robot, in the plane; `mount` is the camera's pose on it.
    `bearing_sd` [rad] is the error of the camera's direction at that moment.
    """
    position = detection.position
    if position is None:
        return None
    x, y, theta = mount
    cosine, sine = math.cos(theta), math.sin(theta)
    # The optical frame's x points right, its z forward.
    rotation = np.array([[sine, cosine], [-cosine, sine]])
    forward, left = rotation @ position.position[[0, 2]] + (x, y)
    distance = math.hypot(forward, left)
    to_polar = np.array(
        [[forward / distance, left / distance], [-left / distance**2, forward / distance**2]]
    )
    jacobian = to_polar @ rotation
    covariance = jacobian @ position.covariance[np.ix_((0, 2), (0, 2))] @ jacobian.T
    covariance = (covariance + covariance.T) / 2 + np.diag((0.0, bearing_sd**2))
    return RecognizedObject(
        object_id=detection.object_id,
        range=distance,
        bearing=math.atan2(left, forward),
        covariance=covariance.ravel(),
        inliers=detection.inliers,
        alternatives=np.array(detection.alternatives, np.uint32),
        corners=detection.corners.ravel(),
    )


def field_of_view(rig: StereoRig, mount: Pose, nearest: float, farthest: float) -> FieldOfView:
    """Return where, relative to the robot, an object is in the image whatever its range.

    A camera off the robot's center covers other bearings near by: `nearest` is increased as much
    as needed to keep half of its view. Bearings of a camera that looks backwards may exceed pi:
    right is always less than left.
    """
    margin = _EDGE * rig.width
    to_left = mount[2] + math.atan((rig.cx - margin) / rig.fx)
    to_right = mount[2] - math.atan((rig.width - 1 - margin - rig.cx) / rig.fx)
    farthest *= 1 - _RANGE_MARGIN
    lefts, rights = _bearing(mount, to_left, farthest), _bearing(mount, to_right, farthest)
    for near in np.geomspace((1 + _RANGE_MARGIN) * nearest, farthest, _STEPS)[:-1].tolist():
        if near <= math.hypot(mount[0], mount[1]):
            continue
        left = min(lefts, _bearing(mount, to_left, near))
        right = max(rights, _bearing(mount, to_right, near))
        if left - right >= 0.5 * (to_left - to_right):
            return FieldOfView(right, left, near, farthest)
    return NO_VIEW


class RangeAgreement:
    """Watches the ratios of ranges by stereo to ranges by size over many detections."""

    def __init__(self) -> None:
        self._ratios: deque[tuple[str, float]] = deque(maxlen=_WINDOW)

    def add(self, name: str, ratio: float) -> str:
        """Add an object's ratio; return what is wrong with its ranges, "" if nothing is."""
        self._ratios.append((name, ratio))
        by_object = {
            key: np.array([ratio for _, ratio in group])
            for key, group in groupby(sorted(self._ratios), key=lambda pair: pair[0])
        }
        medians = {
            key: float(np.median(ratios))
            for key, ratios in by_object.items()
            if len(ratios) >= _LEAST
        }
        return explain_disagreement(name, medians)


def explain_disagreement(name: str, ratios: Mapping[str, float]) -> str:
    """Return what is wrong with an object's ranges, with a remedy; "" if nothing is.

    `ratios` are the ranges by stereo over the ranges by size of all objects, by name.
    """
    off = {key: ratio for key, ratio in ratios.items() if abs(ratio - 1) > SYSTEMATIC}
    if name not in off:
        return ""
    listed = ", ".join(f"{100 * (ratio - 1):+.0f} % for {key}" for key, ratio in off.items())
    if len(ratios) > 1 and off.keys() == ratios.keys() and _have_one_sign(off.values()):
        return (
            f"ranges by stereo differ from ranges by size ({listed}); calibrate the cameras again "
            "with `cairn camera calibrate`, or correct the objects' sizes"
        )
    return (
        f"ranges by stereo differ from ranges by size ({listed}); correct the object's size with "
        f"`cairn object teach '{name}' --size W,H`; if it is right, calibrate the cameras again"
    )


def _have_one_sign(ratios: Iterable[float]) -> bool:
    return len({ratio > 1 for ratio in ratios}) == 1


def _bearing(mount: Pose, direction: float, away: float) -> float:
    """Return the bearing from the robot of a point in `direction` from the camera.

    The point is at the distance `away` from the robot. The bearing is the one next to `direction`.
    """
    x, y, _ = mount
    along = x * math.cos(direction) + y * math.sin(direction)
    reach = -along + math.sqrt(along**2 - x**2 - y**2 + away**2)
    bearing = math.atan2(y + reach * math.sin(direction), x + reach * math.cos(direction))
    return direction + math.remainder(bearing - direction, 2 * math.pi)


def _apparent_size(one: Detection) -> float:
    if one.position is None:
        return math.inf
    area = cv2.contourArea(one.corners.astype(np.float32))
    return float(one.position.position[2]) * math.sqrt(area)


def _combine(
    detection: Detection,
    model: ObjectModel,
    stereo: CameraPosition | None,
    size: CameraPosition | None,
    *,
    has_stereo: bool,
) -> Detection:
    if stereo is None or size is None:
        one = size if stereo is None else stereo
        if one is not None:
            method: RangingMethod = "size" if stereo is None else "stereo"
            return replace(detection, position=one, ranged_by=method)
        why = "its size is not known" if model.size is None else "its size fits no pose"
        pair = "stereo gives no range" if has_stereo else "no right image is available"
        warning = f"{model.name}: no range, because {why} and {pair}"
        if model.size is None:
            warning += f"; give its size with `cairn object teach '{model.name}' --size W,H`"
        return replace(detection, warning=warning)
    far, near = (float(np.linalg.norm(one.position)) for one in (stereo, size))
    ratio = far / near
    if _disagree(stereo, size):
        warning = f"{model.name}: its range is {far:.2f} m by stereo, but {near:.2f} m by its size"
        return replace(detection, range_ratio=ratio, ranges_agree=False, warning=warning)
    agree = consistent(stereo, size) and not _contradict(stereo, size, ratio)
    position = fuse(stereo, size) if agree else _mixture(stereo, size)
    return replace(
        detection, position=position, ranged_by="both", range_ratio=ratio, ranges_agree=agree
    )


def _misalignment_warning(model: ObjectModel, off: float, warning: str) -> str:
    text = (
        f"{model.name}: stereo is not used, because the right image shows it {abs(off):.0f} rows "
        f"{'lower' if off > 0 else 'higher'}: the cameras have moved since their calibration; "
        "calibrate them again with `cairn camera calibrate`"
    )
    return "; ".join(filter(None, (text, warning)))


def _contradict(stereo: CameraPosition, size: CameraPosition, ratio: float) -> bool:
    ray = size.position / np.linalg.norm(size.position)
    deviation = math.sqrt(float(ray @ (stereo.covariance + size.covariance) @ ray))
    off = abs(ratio - 1.0)
    far = float(np.linalg.norm(size.position))
    return off > SYSTEMATIC and off * far > _DEVIATIONS * deviation


def _disagree(one: CameraPosition, other: CameraPosition) -> bool:
    ratio = float(np.linalg.norm(one.position) / np.linalg.norm(other.position))
    return max(ratio, 1 / ratio) > 1 + MOST_DISAGREEMENT


def _mixture(one: CameraPosition, other: CameraPosition) -> CameraPosition:
    """Return mean and covariance of the mixture: one of the two is right, but not known which."""
    off = (one.position - other.position) / 2
    covariance = (one.covariance + other.covariance) / 2 + np.outer(off, off)
    return CameraPosition((one.position + other.position) / 2, covariance)


def _center(detection: Detection, width: int, height: int) -> Array:
    middle = np.array([[[(width - 1) / 2, (height - 1) / 2]]])
    return np.asarray(cv2.perspectiveTransform(middle, detection.homography)[0, 0], np.float64)
