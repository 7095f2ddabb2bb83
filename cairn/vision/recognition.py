"""Recognizes objects in images: nearest descriptors, votes for poses, geometric verification."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision import feature_matching, verification
from cairn.vision.feature_matching import DescriptorIndex, FeatureMatches, MatchGroups
from cairn.vision.features import Features, no_features
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.vision.ranging import CameraPosition
from cairn.vision.verification import SortedFeatures, VerifiedMatch

RangingMethod = Literal["stereo", "size", "both", "none"]

_NEIGHBORS = 10
_RATIO = 0.85
_SAME_DISTANCE = 90.0  # a nearer descriptor matches without the ratio test, unless it repeats
_UNRELATED_DISTANCE = 290.0  # between unrelated descriptors; caps the ratio test's denominator
_SEEDS = 4  # fewest matches that vote for a pose
_FAILURES = 3  # poses of one view that may fail verification before the view is given up
_SAME_OBJECT = 0.5  # overlap of two detections (of area, or of features) that explain one thing
_ALTERNATIVE = 0.7  # strength of an alternative, relative to the strongest explanation
_NESTED = 0.4  # relative share of visible features below which an inner detection is dropped


@dataclass(frozen=True)
class Detection:
    """One instance of an object in one image.

    `view` is the index of the matched view, `homography` (3, 3) maps pixels of that view to pixels
    of the image, `corners` (4, 2) [px] are the view's (top left, top right, bottom right, bottom
    left) in the image, possibly outside of it. `view_points` and `image_points` (n, 2) [px] are the
    n matched features in both. `alternatives` are other objects that explain the same image region
    about as well.

    The rest is set when its range is measured, by `ranged_by`: `position` is that of the object in
    the rectified left optical frame, None if unknown. `range_ratio` is the distance by stereo over
    that by size, where there are both; `ranges_agree` is whether these two agree within their
    uncertainty. `warning` is the reason why `position` is None, or why stereo is not used;
    `rows_off` [px] is then how much lower the right image shows the object, if that is the reason.
    """

    object_id: int
    name: str
    view: int
    homography: NDArray[np.float64]
    corners: NDArray[np.float64]
    view_points: NDArray[np.float64]
    image_points: NDArray[np.float64]
    alternatives: tuple[int, ...]
    position: CameraPosition | None = None
    ranged_by: RangingMethod = "none"
    range_ratio: float | None = None
    ranges_agree: bool = True
    warning: str = ""
    rows_off: float = 0.0

    @property
    def inliers(self) -> int:
        """Return the number of features that agree on the object's pose."""
        return len(self.view_points)

    @property
    def has_stereo_range(self) -> bool:
        """Return whether stereo measured a distance."""
        return self.range_ratio is not None or self.ranged_by == "stereo"


@dataclass(frozen=True)
class _Entry:
    """One view of one object in the index."""

    model: ObjectModel
    number: int

    @property
    def view(self) -> ModelView:
        return self.model.views[self.number]


@dataclass(frozen=True)
class _ImageMatches:
    """The matches of an image, sorted by entry and then by quality, best first.

    `entries` (m,) are indices of entries, `image` (m,) rows of the image's features; `table` (m, 8)
    is that of `MatchGroups`.
    """

    entries: NDArray[np.intp]
    image: NDArray[np.intp]
    table: NDArray[np.float64]


class Recognizer:
    """Recognizes a fixed set of objects by their models."""

    def __init__(self, objects: Sequence[ObjectModel]) -> None:
        self.objects = tuple(objects)
        self._entries = [
            _Entry(model, number) for model in objects for number in range(len(model.views))
        ]
        features = [entry.view.features for entry in self._entries] or [no_features()]
        counts = np.array([len(each) for each in features])
        self._index = DescriptorIndex(np.vstack([each.descriptors for each in features]))
        self._entry_of = np.repeat(np.arange(len(counts)), counts)
        self._features = Features(
            np.vstack([each.points for each in features]),
            np.concatenate([each.scales for each in features]),
            np.concatenate([each.angles for each in features]),
            np.zeros((int(counts.sum()), 0), np.uint8),
        )
        self._diagonals = np.array(
            [math.hypot(entry.view.width, entry.view.height) for entry in self._entries]
        )

    def recognize(self, features: Features, width: int, height: int) -> list[Detection]:
        """Return the objects in an image of `width` x `height` [px], strongest first."""
        if not len(self._index):
            return []
        image = verification.sort_features(features, width, height)
        return self._resolve(image, list(self._verify(image, self._match(image.features))))

    def _match(self, features: Features) -> _ImageMatches:
        """Match each feature to neighbors that are clearly nearer than the background.

        The background distance is that of the last neighbor (McCann and Lowe, "Local naive Bayes
        nearest neighbor", 2012), not of the second as usual: so objects that look alike, several
        views of one object, and its repeated parts do not suppress each other's matches.
        """
        found, distances = self._index.nearest(features.descriptors, _NEIGHBORS)
        ratios = distances / np.clip(distances[:, -1:], 1.0, _UNRELATED_DISTANCE)
        owners = np.where(found >= 0, self._entry_of[found], -1)
        once = (owners[:, :, None] == owners[:, None, :]).sum(axis=2) == 1
        clear = (ratios < _RATIO) | (once & (distances < _SAME_DISTANCE))
        image, column = np.nonzero((found >= 0) & clear)
        rows = found[image, column].astype(np.intp)
        order = np.lexsort((ratios[image, column], self._entry_of[rows]))
        image, rows = image[order], rows[order]
        table = feature_matching.match_table(
            features, self._features, FeatureMatches(image.astype(np.intp), rows)
        )
        return _ImageMatches(self._entry_of[rows], image.astype(np.intp), table)

    def _verify(
        self, image: SortedFeatures, matches: _ImageMatches
    ) -> Iterator[tuple[int, VerifiedMatch]]:
        """Yield all instances of each entry, independently of the other entries."""
        alive = np.ones(len(matches.entries), np.bool_)
        failures = np.zeros(len(self._entries), np.int64)
        while True:
            counts = np.bincount(matches.entries[alive], minlength=len(self._entries))
            tried = np.flatnonzero((counts >= _SEEDS) & (failures < _FAILURES))
            if not len(tried):
                return
            rows = np.flatnonzero(alive)
            rows = rows[np.isin(matches.entries[rows], tried)]
            starts = np.concatenate(([0], np.cumsum(counts[tried])))
            groups = MatchGroups(starts, matches.table[rows])
            best, support = feature_matching.best_poses(groups, self._diagonals[tried])
            for group, entry in enumerate(tried):
                own = rows[starts[group] : starts[group + 1]]
                table = matches.table[own]
                diagonal = float(self._diagonals[entry])
                if not self._is_significant(
                    image, table[best[group]], diagonal, support[group], len(own)
                ):
                    failures[entry] = _FAILURES
                    continue
                members = feature_matching.agreeing(table, int(best[group]), diagonal)
                verified = verification.verify(image, self._entries[entry].view, table[members])
                alive[own[members]] = False
                if verified is None:
                    failures[entry] += 1
                else:
                    alive[own] &= ~np.isin(matches.image[own], verified.image_rows)
                    yield int(entry), verified

    def _is_significant(
        self,
        image: SortedFeatures,
        pose: NDArray[np.float64],
        diagonal: float,
        support: int,
        count: int,
    ) -> bool:
        """Return whether chance explains less than one pose with such support (Chernoff bound)."""
        share = support / count
        chance = feature_matching.chance_of_agreement(
            2.0 ** pose[6], diagonal, image.width * image.height
        )
        if support < _SEEDS or share <= chance:
            return False
        divergence = share * math.log(share / chance)
        if share < 1.0:
            divergence += (1.0 - share) * math.log((1.0 - share) / (1.0 - chance))
        return count * divergence > math.log(count * len(self._entries))

    def _resolve(
        self, image: SortedFeatures, verified: list[tuple[int, VerifiedMatch]]
    ) -> list[Detection]:
        """Keep one detection for each thing in the image: the object that explains it best."""
        kept: list[tuple[VerifiedMatch, Detection]] = []
        for entry, candidate in sorted(verified, key=lambda each: -_strength(each[1])):
            found = self._detection(image, entry, candidate)
            rival = next(
                (k for k, (other, _) in enumerate(kept) if _explains(other, candidate)), None
            )
            if rival is None:
                kept.append((candidate, found))
                continue
            other, best = kept[rival]
            listed = (best.object_id, *best.alternatives)
            comparable = _strength(candidate) >= _ALTERNATIVE * _strength(other)
            if comparable and found.object_id not in listed:
                alternatives = (*best.alternatives, found.object_id)
                kept[rival] = (other, replace(best, alternatives=alternatives))
        return [detection for _, detection in kept]

    def _detection(self, image: SortedFeatures, entry: int, verified: VerifiedMatch) -> Detection:
        model, number = self._entries[entry].model, self._entries[entry].number
        return Detection(
            model.object_id,
            model.name,
            number,
            verified.homography,
            verified.corners,
            model.views[number].features.points[verified.view_rows].astype(np.float64),
            image.features.points[verified.image_rows].astype(np.float64),
            (),
        )


def _strength(verified: VerifiedMatch) -> float:
    """Rate an explanation: many matched features, few visible features unmatched."""
    return len(verified.view_rows) * math.sqrt(verified.share)


def _explains(stronger: VerifiedMatch, weaker: VerifiedMatch) -> bool:
    """Return whether the stronger match explains all that supports the weaker one.

    An object may be visible inside of another that it is a part of, or that it is attached to.
    """
    quads = _quad(stronger.corners), _quad(weaker.corners)
    common = float(cv2.intersectConvexConvex(*quads)[0])
    areas = [cv2.contourArea(quad) for quad in quads]
    if common > _SAME_OBJECT * (sum(areas) - common):
        return True
    both = len(np.intersect1d(stronger.image_rows, weaker.image_rows))
    if both < _SAME_OBJECT * len(weaker.image_rows):
        return False
    return areas[1] > areas[0] or weaker.share < _NESTED * stronger.share


def _quad(corners: NDArray[np.float64]) -> NDArray[np.float32]:
    return corners.astype(np.float32)
