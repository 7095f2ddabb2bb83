"""Finds taught objects in images: nearest descriptors, poses they agree on, and geometric proof."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision import similarities, verification
from cairn.vision.features import Features, none
from cairn.vision.index import DescriptorIndex
from cairn.vision.taught import TaughtObject, View
from cairn.vision.verification import Placed, Scene

_NEIGHBORS = 10
_RATIO = 0.85
_ALIKE = 90.0  # so near that it is the same, of however many objects, but not if one repeats it
_UNLIKE = 290.0  # between descriptors of different things, where so few are known that all are far
_SEEDS = 4
_FAILURES = 3
_SAME = 0.5  # of the area that two quadrangles cover together, or of features that two claim
_AS_WELL = 0.7  # times as strong as the strongest explanation
_NESTED = 0.4  # times the share of the features that are found of the thing around it


@dataclass(frozen=True)
class Recognition:
    """One instance of an object in one image.

    `view` says which of the object's views was matched, `homography` (3, 3) takes that view's
    pixels to the image's, `corners` (4, 2) [px] are the view's (top left, top right, bottom right,
    bottom left) in the image, possibly outside of it. `view_points` and `image_points` (n, 2) [px]
    are where the n matched features lie in both. `alternatives` are other taught objects that
    explain what is seen there about as well.
    """

    object_id: int
    name: str
    view: int
    homography: NDArray[np.float64]
    corners: NDArray[np.float64]
    view_points: NDArray[np.float64]
    image_points: NDArray[np.float64]
    alternatives: tuple[int, ...]

    @property
    def inliers(self) -> int:
        """How many features agree on where the object is."""
        return len(self.view_points)


@dataclass(frozen=True)
class _Entry:
    """One view of one object in the index."""

    taught: TaughtObject
    number: int

    @property
    def view(self) -> View:
        return self.taught.views[self.number]


@dataclass(frozen=True)
class _Match:
    """The matches of an image, sorted by entry and then by how good they are.

    `entries` (m,) says whose they are, `image` (m,) which of the scene's features; `table` (m, 8)
    is that of `similarities.Groups`.
    """

    entries: NDArray[np.intp]
    image: NDArray[np.intp]
    table: NDArray[np.float64]


class Recognizer:
    """What recognizes a set of taught objects; built once for them, and never changed."""

    def __init__(self, objects: Sequence[TaughtObject]) -> None:
        self.objects = tuple(objects)
        self._entries = [
            _Entry(taught, number) for taught in objects for number in range(len(taught.views))
        ]
        features = [entry.view.features for entry in self._entries] or [none()]
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

    def recognize(self, features: Features, width: int, height: int) -> list[Recognition]:
        """The objects in an image of `width` x `height` [px] with these features, surest first."""
        if not len(self._index):
            return []
        scene = verification.scene_of(features, width, height)
        return self._settled(scene, list(self._placed(scene, self._matched(scene.features))))

    def _matched(self, features: Features) -> _Match:
        """Neighbors that are clearly nearer than what else there is.

        What else there is, is told by the last of the neighbors (McCann and Lowe, "Local naive
        Bayes nearest neighbor", 2012), not by the second as usual: objects that look alike, several
        views of one, and repeated parts of it do not take each other's matches away.
        """
        found, distances = self._index.nearest(features.descriptors, _NEIGHBORS)
        ratios = distances / np.clip(distances[:, -1:], 1.0, _UNLIKE)
        owners = np.where(found >= 0, self._entry_of[found], -1)
        once = (owners[:, :, None] == owners[:, None, :]).sum(axis=2) == 1
        clear = (ratios < _RATIO) | (once & (distances < _ALIKE))
        image, column = np.nonzero((found >= 0) & clear)
        rows = found[image, column].astype(np.intp)
        order = np.lexsort((ratios[image, column], self._entry_of[rows]))
        image, rows = image[order], rows[order]
        table = similarities.table_of(
            features, self._features, similarities.Matches(image.astype(np.intp), rows)
        )
        return _Match(self._entry_of[rows], image.astype(np.intp), table)

    def _placed(self, scene: Scene, matches: _Match) -> Iterator[tuple[int, Placed]]:
        """All instances of each entry, as if there were no other."""
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
            groups = similarities.Groups(starts, matches.table[rows])
            best, support = similarities.best_poses(groups, self._diagonals[tried])
            for group, entry in enumerate(tried):
                own = rows[starts[group] : starts[group + 1]]
                table = matches.table[own]
                diagonal = float(self._diagonals[entry])
                if not self._worth(scene, table[best[group]], diagonal, support[group], len(own)):
                    failures[entry] = _FAILURES
                    continue
                members = similarities.agreeing(table, int(best[group]), diagonal)
                placed = verification.place(scene, self._entries[entry].view, table[members])
                alive[own[members]] = False
                if placed is None:
                    failures[entry] += 1
                else:
                    alive[own] &= ~np.isin(matches.image[own], placed.image_rows)
                    yield int(entry), placed

    def _worth(
        self, scene: Scene, pose: NDArray[np.float64], diagonal: float, support: int, count: int
    ) -> bool:
        """Whether less than one pose with such support is to be expected by chance (Chernoff)."""
        share = support / count
        chance = similarities.chance(2.0 ** pose[6], diagonal, scene.width * scene.height)
        if support < _SEEDS or share <= chance:
            return False
        divergence = share * math.log(share / chance)
        if share < 1.0:
            divergence += (1.0 - share) * math.log((1.0 - share) / (1.0 - chance))
        return count * divergence > math.log(count * len(self._entries))

    def _settled(self, scene: Scene, placed: list[tuple[int, Placed]]) -> list[Recognition]:
        """One recognition for each thing that is seen, by the object that explains it best."""
        kept: list[tuple[Placed, Recognition]] = []
        for entry, candidate in sorted(placed, key=lambda each: -_strength(each[1])):
            found = self._recognition(scene, entry, candidate)
            rival = next(
                (k for k, (other, _) in enumerate(kept) if _explains(other, candidate)), None
            )
            if rival is None:
                kept.append((candidate, found))
                continue
            other, best = kept[rival]
            known = (best.object_id, *best.alternatives)
            as_well = _strength(candidate) >= _AS_WELL * _strength(other)
            if as_well and found.object_id not in known:
                alternatives = (*best.alternatives, found.object_id)
                kept[rival] = (other, replace(best, alternatives=alternatives))
        return [recognition for _, recognition in kept]

    def _recognition(self, scene: Scene, entry: int, placed: Placed) -> Recognition:
        taught, number = self._entries[entry].taught, self._entries[entry].number
        return Recognition(
            taught.object_id,
            taught.name,
            number,
            placed.homography,
            placed.corners,
            taught.views[number].features.points[placed.view_rows].astype(np.float64),
            scene.features.points[placed.image_rows].astype(np.float64),
            (),
        )


def _strength(placed: Placed) -> float:
    """How well something explains what is seen: by many features, few others being missed."""
    return len(placed.view_rows) * math.sqrt(placed.share)


def _explains(stronger: Placed, weaker: Placed) -> bool:
    """Whether there is nothing at the weaker one's place but what the stronger one is there.

    A thing may well be seen inside of another that it is a part of, or sticks to.
    """
    common = _common_area(stronger.corners, weaker.corners)
    areas = cv2.contourArea(_quad(stronger.corners)), cv2.contourArea(_quad(weaker.corners))
    if common > _SAME * (sum(areas) - common):
        return True
    both = len(np.intersect1d(stronger.image_rows, weaker.image_rows))
    if both < _SAME * len(weaker.image_rows):
        return False
    return areas[1] > areas[0] or weaker.share < _NESTED * stronger.share


def _common_area(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(cv2.intersectConvexConvex(_quad(one), _quad(other))[0])


def _quad(corners: NDArray[np.float64]) -> NDArray[np.float32]:
    return corners.astype(np.float32)
