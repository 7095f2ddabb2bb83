"""Time of object recognition, recall, and false matches.

The time is that of one core, relative to the extraction of the features of the same image.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from cairn.vision.features import Features, extract
from cairn.vision.object_model import ObjectModel
from cairn.vision.recognition import Detection, Recognizer
from cairn.vision.teaching import make_view
from cairn_lab.benchmarks.pictures import (
    HEIGHT,
    WIDTH,
    Gray,
    Homography,
    Scenery,
    behind,
    drawing,
    hung,
    photographed,
    pictures,
    seen,
)
from cairn_lab.benchmarks.result import Metric

_SHOWN = 10  # objects, known in each database, that scenes show one of
_SCENES, _EMPTY, _SWEPT = 60, 150, 40
_LIMITS = {10: 1.3, 100: None, 1000: 2.0}
_OFF = 15.0  # px, greatest error of a corner of a correct detection

_HARDER = {
    "tilted by 45 deg": Scenery((1.0, 1.0), (45.0, 45.0)),
    "tilted by 55 deg": Scenery((1.0, 1.0), (55.0, 55.0)),
    "tilted by 65 deg": Scenery((1.0, 1.0), (65.0, 65.0)),
    "a third in size": Scenery((0.33, 0.33), (0.0, 20.0)),
    "half in size": Scenery((0.5, 0.5), (0.0, 20.0)),
    "three times in size": Scenery((3.0, 3.0), (0.0, 20.0)),
    "noise of 16 levels": Scenery((1.0, 1.0), (0.0, 30.0), noise=16.0),
    "blur of 2 px": Scenery((1.0, 1.0), (0.0, 30.0), blur=2.0),
    "half covered": Scenery((1.0, 1.0), (0.0, 30.0), covered=0.5),
}


@dataclass(frozen=True)
class _Scene:
    """An image's features, their extraction time [s], the object in it, and its homography."""

    features: Features
    duration: float
    shown: int
    homography: Homography


def measure() -> list[Metric]:
    """Return all metrics."""
    cv2.setNumThreads(1)
    taught = [_taught(number, picture) for number, picture in enumerate(pictures(1000, 1))]
    # A picture with fewer features would not be taught.
    taught.sort(key=lambda each: len(each.views[0].features) < 60)
    random = np.random.default_rng(2)
    scenes = [_scene(taught, Scenery(), random) for _ in range(_SCENES)]
    count = float(np.mean([len(each.features) for each in scenes]))
    duration = float(np.mean([each.duration for each in scenes]))
    metrics = [
        Metric("extraction of features", 1e3 * duration, "ms", note=f"{count:.0f} in an image")
    ]
    recalls = {}
    for known, limit in _LIMITS.items():
        began = time.process_time()
        recognizer = Recognizer(taught[:known])
        built = time.process_time() - began
        recalls[known], seconds = _recall(recognizer, scenes)
        note = f"{1e3 * seconds:.1f} ms; built in {built:.1f} s"
        metrics += [
            Metric(f"recognition among {known} objects, with extraction", 1.0 + seconds / duration,
                   "x extraction", at_most=limit, note=note),
            Metric(f"recall among {known} objects", recalls[known], ""),
        ]  # fmt: skip
    share = recalls[1000] / recalls[10]
    metrics.append(Metric("recall among 1000 of that among 10", share, "", at_least=0.95))
    for known in _LIMITS:
        metrics.append(_false(taught[:known]))
    few = Recognizer(taught[:_SHOWN])
    for name, scenery in _HARDER.items():
        swept = [_scene(taught, scenery, random) for _ in range(_SWEPT)]
        metrics.append(Metric(f"recall, {name}", _recall(few, swept)[0], ""))
    return metrics


def _taught(number: int, picture: Gray) -> ObjectModel:
    return ObjectModel(number, f"object {number}", None, (make_view(picture),))


def _scene(taught: Sequence[ObjectModel], scenery: Scenery, random: np.random.Generator) -> _Scene:
    shown = int(random.integers(_SHOWN))
    picture = taught[shown].views[0].picture
    homography = seen(picture, scenery, random)
    image = hung(behind(random), picture, homography, scenery.covered)
    image = photographed(image, scenery, random)
    began = time.process_time()
    features = extract(image)
    return _Scene(features, time.process_time() - began, taught[shown].object_id, homography)


def _recall(recognizer: Recognizer, scenes: Sequence[_Scene]) -> tuple[float, float]:
    """Return the share of scenes whose object is found at its position; time per scene [s]."""
    found = 0
    began = time.process_time()
    answers = [recognizer.recognize(scene.features, WIDTH, HEIGHT) for scene in scenes]
    duration = time.process_time() - began
    for scene, answer in zip(scenes, answers, strict=True):
        found += any(_right(each, scene, recognizer) for each in answer)
    return found / len(scenes), duration / len(scenes)


def _right(found: Detection, scene: _Scene, recognizer: Recognizer) -> bool:
    if scene.shown not in (found.object_id, *found.alternatives):
        return False
    taught = next(each for each in recognizer.objects if each.object_id == found.object_id)
    truth = cv2.perspectiveTransform(taught.views[found.view].corners[None], scene.homography)[0]
    return float(np.linalg.norm(found.corners - truth, axis=1).max()) < _OFF


def _false(taught: Sequence[ObjectModel]) -> Metric:
    """Measure false matches in images without objects: photographs, and other pictures."""
    random = np.random.default_rng(3)
    recognizer = Recognizer(taught)
    found = 0
    for _ in range(_EMPTY):
        image = behind(random)
        for _ in range(random.integers(0, 8)):
            other = drawing(random)
            image = hung(image, other, seen(other, Scenery(), random))
        features = extract(photographed(image, Scenery(), random))
        found += len(recognizer.recognize(features, WIDTH, HEIGHT))
    return Metric(
        f"false matches per image, {len(taught)} objects known", found / _EMPTY, "",
        at_most=0.01, note=f"{found} in {_EMPTY} images"
    )  # fmt: skip
