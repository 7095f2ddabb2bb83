"""Nearest neighbors among many descriptors: an inverted file of lists around k-means centers.

As the coarse half of Jegou, Douze and Schmid, "Product quantization for nearest neighbor search",
2011: each descriptor lies in the list of its nearest center, and a query looks through the lists of
its few nearest centers only, there exactly. With three times the root of n lists both steps take
time that grows with the root of n.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import DESCRIPTOR

PROBES = 12
"""Lists that a query looks through: nine in ten nearest neighbors are found so, and quickly."""

_ITERATIONS = 8
_SAMPLE = 32  # descriptors for each center in training: more makes the centers hardly better
_FARTHEST = np.iinfo(np.int32).max


class DescriptorIndex:
    """The nearest of n descriptors (n, 128); built once, never changed, the same for the same n."""

    def __init__(self, descriptors: NDArray[np.uint8]) -> None:
        lists = min(len(descriptors), round(3.0 * math.sqrt(len(descriptors))))
        self._centers = _centers(descriptors, lists)
        nearest = self._nearest_centers(descriptors, 1)[:, 0] if lists else np.zeros(0, np.int32)
        self._order = np.argsort(nearest, kind="stable").astype(np.int32)
        self._rows = np.ascontiguousarray(descriptors[self._order])
        self._starts = np.searchsorted(nearest[self._order], np.arange(lists + 1)).astype(np.int32)

    def __len__(self) -> int:
        return len(self._rows)

    def nearest(
        self, queries: NDArray[np.uint8], count: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Which descriptors are nearest to each of q queries (q, 128), and how near.

        Both are (q, count), nearest first; where fewer were found, -1 and infinity. Not always the
        very nearest are found, and those found are always in their right order.
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
        # Not by a product of matrices: its library takes all cores for what is done in no time.
        chosen = np.empty((len(descriptors), count), np.int32)
        squares = np.full((len(descriptors), count), _FARTHEST, np.int32)
        only = np.zeros((len(descriptors), 1), np.int32)
        ends = np.array([0, len(self._centers)], np.int32)
        _scan(np.ascontiguousarray(descriptors), only, ends, self._centers, chosen, squares)
        return chosen


def _centers(descriptors: NDArray[np.uint8], lists: int) -> NDArray[np.uint8]:
    """Lloyd's k-means over every so manyth descriptor, started at every so manyth."""
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


@numba.njit(
    "void(u1[:,::1], i4[:,::1], i4[::1], u1[:,::1], i4[:,::1], i4[:,::1])",
    error_model="numpy",
    cache=True,
    nogil=True,
)
def _scan(
    queries: NDArray[np.uint8],
    probes: NDArray[np.int32],
    starts: NDArray[np.int32],
    rows: NDArray[np.uint8],
    found: NDArray[np.int32],
    squares: NDArray[np.int32],
) -> None:
    """For each query the nearest rows of its lists, by insertion into a short sorted list."""
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
                place = count - 1
                while place > 0 and squares[query, place - 1] > square:
                    squares[query, place] = squares[query, place - 1]
                    found[query, place] = found[query, place - 1]
                    place -= 1
                squares[query, place] = square
                found[query, place] = row
