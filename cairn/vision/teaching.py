"""Teaches objects: makes a model view of a photograph and tests whether it can be recognized."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.vision import feature_matching, verification
from cairn.vision.feature_matching import DescriptorIndex, FeatureMatches, MatchGroups
from cairn.vision.features import extract, select_across_scales
from cairn.vision.images import LEAST_SIDE
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.vision.recognition import Recognizer

Gray = NDArray[np.uint8]
Box = tuple[int, int, int, int]

LONGEST: Final = 800
"""Longest side of a view [px]: a robot's camera resolves no finer detail at usual distances."""

MOST: Final = 300
"""Most features of a view: more hardly help, and each is compared with those of every image."""

# A picture repeats itself if it matches itself at an offset: descriptors nearer than _SIMILAR,
# points further apart than _APART (diagonals), and a verified share of visible features of _SHARE.
# Tiles have a share of 0.6 and more, photographs 0.35 and less, those of chessboards included.
_SIMILAR, _APART, _SHARE = 150.0, 0.1, 0.5
_NEIGHBORS = 10
# The test image of a view: smaller, darker, and rotated in front of a gray wall.
_SCALE, _BRIGHTNESS, _ROTATION_DEG = 0.6, 0.8, 12.0
# The simulated camera: image size [px], noise [gray levels], and sizes of the object tested [px].
_CAMERA, _NOISE = (640, 480), 2.0
_TESTED_SIZES = (400, 300, 220, 160, 120, 90, 65, 45)


def crop(gray: Gray, box: Box) -> Gray:
    """Crop an image to `box`: x, y, width, height [px]; raise `CairnError` if it does not fit."""
    x, y, width, height = box
    rows, columns = gray.shape
    if x < 0 or y < 0 or x + width > columns or y + height > rows:
        raise CairnError(
            f"the box {x},{y},{width},{height} exceeds the image of {columns} x {rows} pixels; "
            "give X,Y,W,H within it"
        )
    if min(width, height) < LEAST_SIDE:
        raise CairnError(
            f"the box {x},{y},{width},{height} is too small; give at least {LEAST_SIDE} x "
            f"{LEAST_SIDE} pixels"
        )
    return gray[y : y + height, x : x + width]


def make_view(gray: Gray) -> ModelView:
    """Make a model view of a photograph (h, w) that shows only the object.

    The view has at most `LONGEST` pixels per side and at most `MOST` features.
    """
    height, width = gray.shape
    factor = LONGEST / max(width, height)
    if factor < 1.0:
        smaller = (max(1, round(width * factor)), max(1, round(height * factor)))
        gray = cv2.resize(gray, smaller, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    picture = np.ascontiguousarray(gray)
    features = select_across_scales(extract(picture), MOST)
    return ModelView(picture.shape[1], picture.shape[0], features, picture)


def why_unrecognizable(view: ModelView) -> str:
    """Return why an object cannot be recognized by this view, "" if it can.

    The view must be recognized in its own picture, made smaller, darker and rotated.
    """
    if not len(view.features):
        return "it has no features, like a blank wall; give a photograph of something with detail"
    scene = _transformed(view)
    one = Recognizer([ObjectModel(0, "", None, (view,))])
    if one.recognize(extract(scene), scene.shape[1], scene.shape[0]):
        return ""
    return (
        f"its {len(view.features)} features are too few or too similar for recognition; give a "
        "sharp photograph of something with more detail"
    )


def smallest_recognized_size(view: ModelView) -> int | None:
    """Return the smallest size [px] (longer side) at which a camera's image of it is recognized.

    The test images show the view slightly rotated, in good light, with a camera's noise. Return
    None if it is not recognized even at the largest size.
    """
    recognizer = Recognizer([ObjectModel(0, "", None, (view,))])
    smallest = None
    for longest in _TESTED_SIZES:
        if not recognizer.recognize(extract(_camera_image(view, longest)), *_CAMERA):
            break
        smallest = longest
    return smallest


def repeats(view: ModelView) -> bool:
    """Return whether the picture contains itself at an offset, as a pattern of tiles does.

    If a camera sees a part of such a picture, it is ambiguous which part that is.
    """
    image, features = extract(view.picture), view.features
    diagonal = math.hypot(view.width, view.height)
    found, distances = DescriptorIndex(features.descriptors).nearest(image.descriptors, _NEIGHBORS)
    off = np.linalg.norm(features.points[found] - image.points[:, None], axis=2)
    row, column = np.nonzero((found >= 0) & (off > _APART * diagonal) & (distances < _SIMILAR))
    if len(row) < verification.LEAST:
        return False
    matches = FeatureMatches(row, found[row, column].astype(np.intp))
    table = feature_matching.match_table(image, features, matches)
    groups = MatchGroups(np.array([0, len(table)]), table)
    (best,), (support,) = feature_matching.best_poses(groups, np.array([diagonal]))
    if support < verification.LEAST:
        return False
    members = feature_matching.agreeing(table, int(best), diagonal)
    sorted_image = verification.sort_features(image, view.width, view.height)
    verified = verification.verify(sorted_image, view, table[members])
    return verified is not None and verified.share >= _SHARE


def look_alikes(view: ModelView, known: Sequence[ObjectModel]) -> list[ObjectModel]:
    """Return the known objects that are recognized in this view."""
    if not known:
        return []
    features = extract(view.picture)
    found = Recognizer(known).recognize(features, view.width, view.height)
    numbers = {one.object_id for one in found}
    numbers.update(other for one in found for other in one.alternatives)
    return [taught for taught in known if taught.object_id in numbers]


def _camera_image(view: ModelView, longest: int) -> Gray:
    """Simulate a camera image of a view that is `longest` [px] large, slightly rotated.

    The image is cropped to the surroundings of the view: the rest of a camera's image is empty.
    """
    width, height = (min(side, 2 * longest) for side in _CAMERA)
    scale = longest / max(view.width, view.height)
    middle = ((view.width - 1) / 2, (view.height - 1) / 2)
    turn = np.asarray(cv2.getRotationMatrix2D(middle, _ROTATION_DEG, scale), np.float64)
    turn[:, 2] += ((width - view.width) / 2, (height - view.height) / 2)
    picture = view.picture
    if scale < 1.0:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.5 / scale), np.uint8)
    # A gradient from dark to bright: a camera exposes for the room, not for the object.
    scene = np.tile(np.linspace(15.0, 240.0, width), (height, 1)).astype(np.uint8)
    cv2.warpAffine(picture, turn, (width, height), dst=scene, borderMode=cv2.BORDER_TRANSPARENT)
    noise = np.random.default_rng(0).normal(0.0, _NOISE, scene.shape)
    return np.clip(np.rint(scene + noise), 0, 255).astype(np.uint8)


def _transformed(view: ModelView) -> Gray:
    side = round(1.2 * max(view.width, view.height))
    middle = ((view.width - 1) / 2, (view.height - 1) / 2)
    turn = np.asarray(cv2.getRotationMatrix2D(middle, _ROTATION_DEG, _SCALE), np.float64)
    turn[:, 2] += ((side - view.width) / 2, (side - view.height) / 2)
    # Blur first, to avoid aliasing.
    smooth = cv2.GaussianBlur(view.picture, (0, 0), 0.5 / _SCALE)
    moved = cv2.warpAffine(smooth, turn, (side, side), borderValue=128)
    return np.asarray(cv2.convertScaleAbs(moved, alpha=_BRIGHTNESS), np.uint8)
