"""How far a map is from the truth: errors of the poses, relations of nearby poses, and walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.ray_casting import clearance
from cairn.components.slam.mapping import Mapper
from cairn.planar.grid import OCCUPIED
from cairn.planar.poses import Pose, compose, relative
from cairn.planar.scan_grid import ScanGrid
from tests.components.slam.recordings import Recording

Array = NDArray[np.float64]

BROKEN_M = 0.5
"""A map is broken if a pose is farther than this from the truth [m]."""
_CELL = 0.05
_PAIRS, _NEAR_M, _REACH_M = 4000, 5.0, 30.0


@dataclass(frozen=True)
class MapErrors:
    """The errors of a map against the truth.

    Attributes:
        relation_m: mean error of the relative position of poses within 5 m of each other [m].
        relation_deg: mean error of their relative heading [degrees].
        worst_m: largest error of a position after the alignment of the whole trajectory [m].
        walls: share of the occupied cells whose center is within 5 cm of a true wall [1].
        walls_10cm: the same within 10 cm [1].

    """

    relation_m: float
    relation_deg: float
    worst_m: float
    walls: float
    walls_10cm: float

    @property
    def is_broken(self) -> bool:
        """Whether the map is bent."""
        return self.worst_m > BROKEN_M


@dataclass(frozen=True)
class Island:
    """A connected part of the map: the numbers of its keyframes, and of its scans."""

    keyframes: NDArray[np.int64]
    scans: NDArray[np.int64]


def islands_of(mapper: Mapper) -> list[Island]:
    """Return the parts of a map that nothing connects, the one with the most keyframes first.

    Only the first one is the map. Where the robot was moved by hand, and no place was recognized
    afterward, the position of the others relative to it is unknown.
    """
    first = mapper.graph.islands()
    numbers = first[[step.keyframe for step in mapper.trajectory]]
    islands = [
        Island(np.flatnonzero(first == number), np.flatnonzero(numbers == number))
        for number in np.unique(numbers).tolist()
    ]
    return sorted(islands, key=lambda one: (-len(one.keyframes), int(one.keyframes[0])))


def map_errors(mapper: Mapper, recording: Recording) -> MapErrors:
    """Return the errors of the largest island of a finished map."""
    main = islands_of(mapper)[0]
    inside = main.scans
    poses, truth = mapper.poses()[inside], np.array(recording.truth)[inside]
    shift = alignment_to(truth, poses)
    worst = float(position_errors(truth, poses, shift).max())
    meters, degrees = relation_errors(truth, poses)
    walls = wall_distances(mapper, recording, main, shift)
    shares = (float(np.mean(walls <= most)) if len(walls) else 0.0 for most in (0.05, 0.1))
    return MapErrors(meters, degrees, worst, *shares)


def alignment_to(truth: Array, poses: Array) -> Pose:
    """Return the pose of the map's frame in the world that fits the positions best."""
    center, other = poses[:, :2].mean(axis=0), truth[:, :2].mean(axis=0)
    a, b = poses[:, :2] - center, truth[:, :2] - other
    turn = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    cosine, sine = math.cos(turn), math.sin(turn)
    x = other[0] - (cosine * center[0] - sine * center[1])
    y = other[1] - (sine * center[0] + cosine * center[1])
    return float(x), float(y), turn


def position_errors(truth: Array, poses: Array, shift: Pose) -> Array:
    """Return the distance (n,) [m] of each position from the truth."""
    x, y, turn = shift
    cosine, sine = math.cos(turn), math.sin(turn)
    moved_x = x + cosine * poses[:, 0] - sine * poses[:, 1]
    moved_y = y + sine * poses[:, 0] + cosine * poses[:, 1]
    errors: Array = np.hypot(moved_x - truth[:, 0], moved_y - truth[:, 1])
    return errors


def relation_errors(truth: Array, poses: Array, seed: int = 0) -> tuple[float, float]:
    """Return the mean errors [m], [degrees] of the relations of random pairs of nearby poses.

    The metric of the SLAM benchmark (Kuemmerle et al. 2009), with the truth instead of relations
    that people have checked.
    """
    random = np.random.default_rng(seed)
    meters, degrees = [], []
    tries = random.integers(0, len(truth), (40 * _PAIRS, 2))
    near = np.hypot(*(truth[tries[:, 0], :2] - truth[tries[:, 1], :2]).T) < _NEAR_M
    for first, second in tries[near][:_PAIRS].tolist():
        expected = relative(tuple(truth[first].tolist()), tuple(truth[second].tolist()))
        found = relative(tuple(poses[first].tolist()), tuple(poses[second].tolist()))
        error = relative(expected, found)
        meters.append(math.hypot(error[0], error[1]))
        degrees.append(abs(math.degrees(error[2])))
    return float(np.mean(meters)), float(np.mean(degrees))


def wall_distances(mapper: Mapper, recording: Recording, island: Island, shift: Pose) -> Array:
    """Return the distance (n,) [m] of occupied cells of the drawn map from the true walls."""
    grid = ScanGrid(_CELL, _REACH_M)
    for number in island.keyframes.tolist():
        rays = mapper.keyframes[number].rays
        if rays is not None:
            grid.add(compose(shift, mapper.graph.pose(number)), rays.rays())
    cells = grid.grid()
    rows, columns = np.nonzero(cells.values == OCCUPIED)
    segments = WorldLayout.of(recording.course.world).solid_segments.segments
    people = np.zeros((0, 3))
    return np.array(
        [
            clearance(*cells.frame.point(row, column), segments, people)[0]
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        ]
    )
