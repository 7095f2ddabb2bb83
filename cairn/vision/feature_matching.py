"""Matches features: nearest descriptors of an index, and matches that agree on one pose.

`DescriptorIndex` is the coarse half of Jegou, Douze and Schmid, "Product quantization for nearest
neighbor search", 2011: each descriptor lies in the list of its nearest k-means center, and a query
searches the lists of its few nearest centers, exactly. With three times the root of n lists both
steps take time that grows with the root of n. A k-d tree (scipy.spatial.KDTree) is not faster than
a search of all rows in 128 dimensions.

Votes for poses follow Philbin et al., "Object retrieval with large vocabularies and fast spatial
matching", 2007, section 3.2: each match alone gives scale, rotation and position of the view, and
every match is tried as a hypothesis. Nothing is random.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numba
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import DESCRIPTOR, Features

PROBES = 12
"""Lists that a query searches: nine in ten nearest neighbors are found this way, and quickly."""

_ITERATIONS = 8
_SAMPLE = 32  # descriptors per center in training: more descriptors hardly improve the centers
_FARTHEST = np.iinfo(np.int32).max

NEAR = 0.25
"""Position error that a match may have under the pose of another, in diagonals of the view.

It is large because such a pose ignores foreshortening, and scale and angle of a feature are rough.
"""

_TURN = math.radians(35.0)
_OCTAVES = 1.0
_HYPOTHESES = 400  # per view: more than enough to hold a right one

kernel = partial(numba.njit, error_model="numpy", cache=True, nogil=True)
"""Compiles a function for a signature, when its module is imported for the first time."""


class DescriptorIndex:
    """Finds the nearest of n descriptors (n, 128). It is immutable and deterministic."""

    def __init__(self, descriptors: NDArray[np.uint8]) -> None:
        lists = min(len(descriptors), round(3.0 * math.sqrt(len(descriptors))))
        self._centers = _k_means(descriptors, lists)
        nearest = self._nearest_centers(descriptors, 1)[:, 0] if lists else np.zeros(0, np.int32)
        self._order = np.argsort(nearest, kind="stable").astype(np.int32)
        self._rows = np.ascontiguousarray(descriptors[self._order])
        self._starts = np.searchsorted(nearest[self._order], np.arange(lists + 1)).astype(np.int32)

    def __len__(self) -> int:
        return len(self._rows)

    def nearest(
        self, queries: NDArray[np.uint8], count: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return the nearest descriptors of q queries (q, 128), and their distances.

        Both arrays are (q, count), nearest first; missing entries are -1 and infinity. The search
        may miss some of the nearest descriptors; the order of those it finds is always right.
        """
        found = np.full((len(queries), count), -1, np.int32)
        squares = np.full((len(queries), count), _FARTHEST, np.int32)
        if len(self) and len(queries):
            probes = self._nearest_centers(queries, min(PROBES, len(self._centers)))
            _scan(np.ascontiguousarray(queries), probes, self._starts, self._rows, found, squares)
            found = np.where(found >= 0, self._order[found], np.int32(-1))
        distances = np.where(found >= 0, np.sqrt(squares.astype(np.float32)), np.float32(np.inf))
        return found, distances.astype(np.float32, copy=False)

    def _nearest_centers(self, descriptors: NDArray[np.uint8], count: int) -> NDArray[np.int32]:
        # A matrix product (BLAS) would occupy all cores for work that takes next to no time.
        chosen = np.empty((len(descriptors), count), np.int32)
        squares = np.full((len(descriptors), count), _FARTHEST, np.int32)
        only = np.zeros((len(descriptors), 1), np.int32)
        ends = np.array([0, len(self._centers)], np.int32)
        _scan(np.ascontiguousarray(descriptors), only, ends, self._centers, chosen, squares)
        return chosen


@dataclass(frozen=True)
class FeatureMatches:
    """m matches, best first: `image` (m,) and `view` (m,) are rows in the features of both."""

    image: NDArray[np.intp]
    view: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.image)

    def at(self, indices: NDArray[np.intp] | NDArray[np.bool_]) -> FeatureMatches:
        """Return only these matches."""
        return FeatureMatches(self.image[indices], self.view[indices])


@dataclass(frozen=True)
class MatchGroups:
    """Matches of many views, grouped by view, with what is needed to compare their poses.

    Group g is rows `starts[g]` to `starts[g + 1]`. `table` (m, 8) holds x, y in the image, x, y in
    the view, cosine and sine of the rotation times the scale, logarithm (base 2) of the scale, and
    rotation [rad].
    """

    starts: NDArray[np.int64]
    table: NDArray[np.float64]


def match_table(image: Features, view: Features, matches: FeatureMatches) -> NDArray[np.float64]:
    """Return the rows of `MatchGroups.table` for these matches."""
    octaves = np.log2(image.scales[matches.image] / view.scales[matches.view])
    turns = image.angles[matches.image] - view.angles[matches.view]
    scales = np.exp2(octaves)
    return np.column_stack(
        (
            image.points[matches.image],
            view.points[matches.view],
            scales * np.cos(turns),
            scales * np.sin(turns),
            octaves,
            turns,
        )
    ).astype(np.float64)


def best_poses(
    groups: MatchGroups, diagonals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for each group the match whose pose most matches agree with, and their number.

    `diagonals` (g,) [px] are those of the views. The number includes the match itself. Of equally
    good matches the first one is returned.
    """
    best = np.zeros(len(diagonals), np.int64)
    support = np.zeros(len(diagonals), np.int64)
    _enumerate(groups.starts, groups.table, NEAR * diagonals, best, support)
    return best, support


def agreeing(table: NDArray[np.float64], match: int, diagonal: float) -> NDArray[np.bool_]:
    """Return which rows agree with the pose of row `match`, for a view of that diagonal [px]."""
    members = np.zeros(len(table), np.bool_)
    _members(np.ascontiguousarray(table), match, NEAR * diagonal, members)
    return members


def chance_of_agreement(scale: float, diagonal: float, area: float) -> float:
    """Return the probability that a match agrees by chance with a pose of `scale`.

    `diagonal` [px] is the view's, `area` [px^2] the image's.
    """
    share = math.pi * (NEAR * diagonal * scale) ** 2 / area
    return min(1.0, share) * (_TURN / math.pi) * (_OCTAVES / 2.0)


def _k_means(descriptors: NDArray[np.uint8], lists: int) -> NDArray[np.uint8]:
    """Return centers by Lloyd's k-means over evenly spaced descriptors, from evenly spaced ones."""
    if not lists:
        return np.zeros((0, DESCRIPTOR), np.uint8)
    step = max(1, len(descriptors) // (lists * _SAMPLE))
    sample = descriptors[::step].astype(np.float32)
    centers = sample[np.linspace(0, len(sample) - 1, lists).astype(np.intp)].copy()
    for _ in range(_ITERATIONS):
        nearest = (sample @ centers.T - 0.5 * np.square(centers).sum(axis=1)).argmax(axis=1)
        order = np.argsort(nearest, kind="stable")
        used, starts = np.unique(nearest[order], return_index=True)
        sums = np.add.reduceat(sample[order], starts, axis=0)
        centers[used] = sums / np.diff(starts, append=len(order))[:, None]
    return np.rint(centers).astype(np.uint8)


@kernel("void(u1[:,::1], i4[:,::1], i4[::1], u1[:,::1], i4[:,::1], i4[:,::1])")
def _scan(
    queries: NDArray[np.uint8],
    probes: NDArray[np.int32],
    starts: NDArray[np.int32],
    rows: NDArray[np.uint8],
    found: NDArray[np.int32],
    squares: NDArray[np.int32],
) -> None:
    """Insert the nearest rows of each query's lists into its short sorted list."""
    count = found.shape[1]
    for query in range(queries.shape[0]):
        for probe in range(probes.shape[1]):
            center = probes[query, probe]
            for row in range(starts[center], starts[center + 1]):
                square = np.int32(0)
                for element in range(DESCRIPTOR):
                    difference = np.int32(queries[query, element]) - np.int32(rows[row, element])
                    square += difference * difference
                if square >= squares[query, count - 1]:
                    continue
                rank = count - 1
                while rank > 0 and squares[query, rank - 1] > square:
                    squares[query, rank] = squares[query, rank - 1]
                    found[query, rank] = found[query, rank - 1]
                    rank -= 1
                squares[query, rank] = square
                found[query, rank] = row


@kernel("b1(f8[:,::1], i8, i8, f8)")
def _agree(table: NDArray[np.float64], one: int, other: int, near: float) -> bool:
    octaves = table[other, 6] - table[one, 6]
    if octaves > _OCTAVES or octaves < -_OCTAVES:
        return False
    turn = abs(table[other, 7] - table[one, 7])
    while turn > math.pi:
        turn = abs(turn - 2.0 * math.pi)
    if turn > _TURN:
        return False
    cosine, sine = table[one, 4], table[one, 5]
    x, y = table[other, 2] - table[one, 2], table[other, 3] - table[one, 3]
    dx = table[other, 0] - table[one, 0] - (cosine * x - sine * y)
    dy = table[other, 1] - table[one, 1] - (sine * x + cosine * y)
    return bool(dx * dx + dy * dy <= near * near * (cosine * cosine + sine * sine))


@kernel("void(f8[:,::1], i8, f8, b1[::1])")
def _members(
    table: NDArray[np.float64], match: int, near: float, members: NDArray[np.bool_]
) -> None:
    for row in range(members.size):
        members[row] = _agree(table, match, row, near)


@kernel("void(i8[::1], f8[:,::1], f8[::1], i8[::1], i8[::1])")
def _enumerate(
    starts: NDArray[np.int64],
    table: NDArray[np.float64],
    near: NDArray[np.float64],
    best: NDArray[np.int64],
    support: NDArray[np.int64],
) -> None:
    for group in range(starts.size - 1):
        start, end = starts[group], starts[group + 1]
        for one in range(start, min(end, start + _HYPOTHESES)):
            votes = 0
            for other in range(start, end):
                if _agree(table, one, other, near[group]):
                    votes += 1
            if votes > support[group]:
                support[group] = votes
                best[group] = one - start
