"""Which matches of a view agree on one pose of it: each match alone tells scale, turn and place.

The enumeration of Philbin et al., "Object retrieval with large vocabularies and fast spatial
matching", 2007, section 3.2: nothing is drawn by chance, and every match gets its turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import Features

NEAR = 0.25
"""How far off the pose of one match may put another, in diagonals of the view in the image.

Much, as the pose tells nothing of foreshortening, and a feature's scale and angle are rough.
"""

_TURN = math.radians(35.0)
_OCTAVES = 1.0
_HYPOTHESES = 400  # of one view: more than enough to hold a right one


@dataclass(frozen=True)
class Matches:
    """m matches, best first: `image` (m,) and `view` (m,) are rows in the features of both."""

    image: NDArray[np.intp]
    view: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.image)

    def at(self, indices: NDArray[np.intp] | NDArray[np.bool_]) -> Matches:
        """Only these matches."""
        return Matches(self.image[indices], self.view[indices])


@dataclass(frozen=True)
class Groups:
    """Matches of many views with what is needed to compare their poses, a view's side by side.

    Group g is `starts[g]` to `starts[g + 1]`. `table` (m, 8): x, y in the image, x, y in the view,
    cosine and sine of the turn times the scale, logarithm (base 2) of the scale, and turn [rad].
    """

    starts: NDArray[np.int64]
    table: NDArray[np.float64]


def table_of(image: Features, view: Features, matches: Matches) -> NDArray[np.float64]:
    """The rows of `Groups.table` for these matches."""
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
    groups: Groups, diagonals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each group the match whose pose most others agree with, and how many (with itself).

    `diagonals` (g,) [px] are the views'. Of matches that are equally good the first.
    """
    best = np.zeros(len(diagonals), np.int64)
    support = np.zeros(len(diagonals), np.int64)
    _enumerate(groups.starts, groups.table, NEAR * diagonals, best, support)
    return best, support


def agreeing(table: NDArray[np.float64], match: int, diagonal: float) -> NDArray[np.bool_]:
    """Which rows agree with the pose that row `match` tells, for a view of that diagonal [px]."""
    members = np.zeros(len(table), np.bool_)
    _members(np.ascontiguousarray(table), match, NEAR * diagonal, members)
    return members


def chance(scale: float, diagonal: float, area: float) -> float:
    """How probable it is that a match agrees by chance with a pose of `scale`.

    For a view of that diagonal [px] in an image of that area [px^2].
    """
    place = math.pi * (NEAR * diagonal * scale) ** 2 / area
    return min(1.0, place) * (_TURN / math.pi) * (_OCTAVES / 2.0)


@numba.njit("b1(f8[:,::1], i8, i8, f8)", error_model="numpy", cache=True, nogil=True)
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


@numba.njit("void(f8[:,::1], i8, f8, b1[::1])", error_model="numpy", cache=True, nogil=True)
def _members(
    table: NDArray[np.float64], match: int, near: float, members: NDArray[np.bool_]
) -> None:
    for row in range(members.size):
        members[row] = _agree(table, match, row, near)


@numba.njit(
    "void(i8[::1], f8[:,::1], f8[::1], i8[::1], i8[::1])",
    error_model="numpy",
    cache=True,
    nogil=True,
)
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
            agreeing = 0
            for other in range(start, end):
                if _agree(table, one, other, near[group]):
                    agreeing += 1
            if agreeing > support[group]:
                support[group] = agreeing
                best[group] = one - start
