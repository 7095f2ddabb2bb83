"""From a photograph to a view that can be taught: cut out, checked, compared with what is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.vision import similarities, verification
from cairn.vision.features import extract, varied
from cairn.vision.images import LEAST_SIDE
from cairn.vision.index import DescriptorIndex
from cairn.vision.recognition import Recognizer
from cairn.vision.taught import TaughtObject, View

Gray = NDArray[np.uint8]
Box = tuple[int, int, int, int]

LONGEST: Final = 800
"""Sides of views [px]: what is finer in a photograph no camera sees from where robots look."""

MOST: Final = 300
"""Features of a view: more tell hardly more, and each is compared with every image's."""

# A picture is found in itself: features so much alike (distance of descriptors), so far apart (in
# diagonals), make a second place of it if so large a share of what is to be seen there is. Tiles
# have 0.6 and more, photographs 0.35 and less, those of chessboards included.
_ALIKE, _APART, _SHARE = 150.0, 0.1, 0.5
_NEIGHBORS = 10
# What it is tried on: smaller, darker, and turned in front of a gray wall.
_SMALLER, _DARKER, _TURNED_DEG = 0.6, 0.8, 12.0
# The image of a usual camera [px], its noise [gray levels], and how large it may show an object.
_CAMERA, _NOISE = (640, 480), 2.0
_TRIED = (400, 300, 220, 160, 120, 90, 65, 45)


def cut(gray: Gray, box: Box) -> Gray:
    """The part x, y, width, height [px] of an image; raises `CairnError` if it is not in there."""
    x, y, width, height = box
    rows, columns = gray.shape
    if x < 0 or y < 0 or x + width > columns or y + height > rows:
        raise CairnError(
            f"the box {x},{y},{width},{height} reaches beyond the image of {columns} x {rows} "
            "pixels: give X,Y,W,H within it"
        )
    if min(width, height) < LEAST_SIDE:
        raise CairnError(
            f"the box {x},{y},{width},{height} is too small: give at least {LEAST_SIDE} pixels "
            "each way"
        )
    return gray[y : y + height, x : x + width]


def view_of(gray: Gray) -> View:
    """The view that a photograph (h, w) of the object alone is.

    At most `LONGEST` pixels a side, with at most `MOST` features.
    """
    height, width = gray.shape
    factor = LONGEST / max(width, height)
    if factor < 1.0:
        smaller = (max(1, round(width * factor)), max(1, round(height * factor)))
        gray = cv2.resize(gray, smaller, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    picture = np.ascontiguousarray(gray)
    features = varied(extract(picture), MOST)
    return View(picture.shape[1], picture.shape[0], features, picture)


def unfit(view: View) -> str:
    """Why an object would not be recognized by this view; empty if it would.

    It is tried: the picture, smaller, darker and turned, must be recognized by it.
    """
    if not len(view.features):
        return "it shows nothing that stands out, such as a blank wall"
    scene = _scene(view)
    one = Recognizer([TaughtObject(0, "", None, (view,))])
    if one.recognize(extract(scene), scene.shape[1], scene.shape[0]):
        return ""
    return (
        f"its {len(view.features)} features are too few, or too much alike, to recognize it by: "
        "give a sharp photograph of something with more detail"
    )


def recognized_from(view: View) -> int | None:
    """From how large on [px], its longer side in a camera's image, this view is recognized.

    It is tried upright and turned a little in an image that is well lit, with the noise of a
    camera. None if it is not even as large as the image allows.
    """
    recognizer = Recognizer([TaughtObject(0, "", None, (view,))])
    smallest = None
    for longest in _TRIED:
        if not recognizer.recognize(extract(_before_a_camera(view, longest)), *_CAMERA):
            break
        smallest = longest
    return smallest


def repeats(view: View) -> bool:
    """Whether the picture is in itself at another place too, as one made of tiles is.

    Where a part of it is seen, nobody can tell which part it is.
    """
    scene, features = extract(view.picture), view.features
    diagonal = math.hypot(view.width, view.height)
    found, distances = DescriptorIndex(features.descriptors).nearest(scene.descriptors, _NEIGHBORS)
    off = np.linalg.norm(features.points[found] - scene.points[:, None], axis=2)
    image, column = np.nonzero((found >= 0) & (off > _APART * diagonal) & (distances < _ALIKE))
    if len(image) < verification.LEAST:
        return False
    matches = similarities.Matches(image, found[image, column].astype(np.intp))
    table = similarities.table_of(scene, features, matches)
    groups = similarities.Groups(np.array([0, len(table)]), table)
    (best,), (support,) = similarities.best_poses(groups, np.array([diagonal]))
    if support < verification.LEAST:
        return False
    members = similarities.agreeing(table, int(best), diagonal)
    there = verification.scene_of(scene, view.width, view.height)
    placed = verification.place(there, view, table[members])
    return placed is not None and placed.share >= _SHARE


def look_alikes(view: View, known: Sequence[TaughtObject]) -> list[TaughtObject]:
    """Those of the known objects that are recognized in this view."""
    if not known:
        return []
    features = extract(view.picture)
    found = Recognizer(known).recognize(features, view.width, view.height)
    numbers = {one.object_id for one in found}
    numbers.update(other for one in found for other in one.alternatives)
    return [taught for taught in known if taught.object_id in numbers]


def _before_a_camera(view: View, longest: int) -> Gray:
    """What a usual camera shows of a view so large [px], turned a little, and of what is around it.

    Further off than its longer side there is nothing to be found: it is left out, being most of
    the image.
    """
    width, height = (min(side, 2 * longest) for side in _CAMERA)
    scale = longest / max(view.width, view.height)
    middle = ((view.width - 1) / 2, (view.height - 1) / 2)
    turn = np.asarray(cv2.getRotationMatrix2D(middle, _TURNED_DEG, scale), np.float64)
    turn[:, 2] += ((width - view.width) / 2, (height - view.height) / 2)
    picture = view.picture
    if scale < 1.0:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.5 / scale), np.uint8)
    # Dark and bright at its sides: a camera exposes for the room, not for the object.
    scene = np.tile(np.linspace(15.0, 240.0, width), (height, 1)).astype(np.uint8)
    cv2.warpAffine(picture, turn, (width, height), dst=scene, borderMode=cv2.BORDER_TRANSPARENT)
    noise = np.random.default_rng(0).normal(0.0, _NOISE, scene.shape)
    return np.clip(np.rint(scene + noise), 0, 255).astype(np.uint8)


def _scene(view: View) -> Gray:
    side = round(1.2 * max(view.width, view.height))
    middle = ((view.width - 1) / 2, (view.height - 1) / 2)
    turn = np.asarray(cv2.getRotationMatrix2D(middle, _TURNED_DEG, _SMALLER), np.float64)
    turn[:, 2] += ((side - view.width) / 2, (side - view.height) / 2)
    # Without this the picture would be full of what is finer than its pixels.
    smooth = cv2.GaussianBlur(view.picture, (0, 0), 0.5 / _SMALLER)
    moved = cv2.warpAffine(smooth, turn, (side, side), borderValue=128)
    return np.asarray(cv2.convertScaleAbs(moved, alpha=_DARKER), np.uint8)
