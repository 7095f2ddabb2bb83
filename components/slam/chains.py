"""Chains of steps: a pose graph without the poses that only steps connect, and how they follow.

Most poses have only a step before and a step after them. Such a chain is one constraint between its
ends (Carlevaris-Bianco, Kaess and Eustice 2014): with few poses left, the graph is optimized within
milliseconds. The poses of a chain then take up what its ends were moved by, each by as much as its
step is uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled

Array = NDArray[np.float64]

# A chain has at most so many steps, so that its error is nearly linear in the errors of its steps:
# where a loop moves poses by 1 to 2.6 m, they are 0.2 to 0.6 mm beside those of the whole graph,
# with 50 steps 3 to 18 mm.
_LONGEST = 10


@dataclass(frozen=True)
class Chains:
    """The chains of a graph of n poses, of which m are nodes: those that stay.

    Attributes:
        nodes: (m,) numbers of the nodes, increasing. The k-th chain ends at the k-th node and
            starts at the node before, unless `steps[k]` is 0.
        steps: (m,) how many steps it has.
        measured: (n, 3) the step to each pose: x, y [m], heading [rad] in the frame before.
        covariances: (n, 3, 3) of the steps, in the frame of the pose itself.

    """

    nodes: NDArray[np.int64]
    steps: NDArray[np.int64]
    measured: Array
    covariances: Array

    def joined(self) -> tuple[Array, Array]:
        """Return the motion (m, 3) along each chain, and its information (m, 3, 3)."""
        motions, covariances = _joined(self.nodes, self.steps, self.measured, self.covariances)
        covariances[self.steps == 0] = np.eye(3)
        return motions, np.asarray(np.linalg.inv(covariances), np.float64)

    def spread(self, poses: Array) -> Array:
        """Return all poses (n, 3), given those of the nodes (m, 3).

        Those between two nodes are where the steps, together, deviate least from the measurements.
        """
        return _spread(self.nodes, self.steps, self.measured, self.covariances, poses)


def chains_of(
    count: int, steps: Iterable[tuple[int, tuple[float, float, float], Array]], kept: Iterable[int]
) -> Chains:
    """Return the chains of a graph.

    Args:
        count: number of poses.
        steps: pose, motion from the pose before, and its information (3, 3), at most one for each
            pose.
        kept: poses that have other constraints.

    """
    measured, information = np.zeros((count, 3)), np.zeros((count, 3, 3))
    has_step = np.zeros(count + 1, np.bool_)
    listed = list(steps)
    if listed:
        numbers = [number for number, _, _ in listed]
        has_step[numbers] = True
        measured[numbers] = [motion for _, motion, _ in listed]
        information[numbers] = [matrix for _, _, matrix in listed]
    information[~has_step[:-1]] = np.eye(3)
    covariances = np.linalg.inv(information)
    is_node = ~has_step[:-1] | ~has_step[1:]
    is_node[list(kept)] = True
    chosen, lengths, length = [], [], 0
    for number, (stays, continues) in enumerate(
        zip(is_node.tolist(), has_step.tolist(), strict=False)
    ):
        length = length + 1 if continues else 0
        if stays or length == _LONGEST:
            chosen.append(number)
            lengths.append(length)
            length = 0
    return Chains(
        np.array(chosen, np.int64),
        np.array(lengths, np.int64),
        measured,
        np.asarray(covariances, np.float64),
    )


@compiled()
def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@compiled()
def _compose(base: Array, offset: Array, result: Array) -> None:
    """Write the pose that `offset` is in the frame `base` to `result`, which may be one of them."""
    cosine, sine = math.cos(base[2]), math.sin(base[2])
    x = base[0] + cosine * offset[0] - sine * offset[1]
    y = base[1] + sine * offset[0] + cosine * offset[1]
    result[2] = _wrap(base[2] + offset[2])
    result[0], result[1] = x, y


@compiled()
def _relative(base: Array, pose: Array, result: Array) -> None:
    """Write a pose in the frame `base` to `result`."""
    cosine, sine = math.cos(base[2]), math.sin(base[2])
    dx, dy = pose[0] - base[0], pose[1] - base[1]
    result[0], result[1] = cosine * dx + sine * dy, cosine * dy - sine * dx
    result[2] = _wrap(pose[2] - base[2])


@compiled()
def turn_back(motion: Array, adjoint: Array) -> None:
    """Write the adjoint (3, 3) that takes errors before a motion to the frame after it."""
    x, y = motion[0], motion[1]
    cosine, sine = math.cos(motion[2]), math.sin(motion[2])
    adjoint[0, 0], adjoint[0, 1], adjoint[0, 2] = cosine, sine, -(cosine * y - sine * x)
    adjoint[1, 0], adjoint[1, 1], adjoint[1, 2] = -sine, cosine, sine * y + cosine * x
    adjoint[2, 0], adjoint[2, 1], adjoint[2, 2] = 0.0, 0.0, 1.0


@compiled(
    "Tuple((float64[:, ::1], float64[:, :, ::1]))(int64[::1], int64[::1], float64[:, ::1],"
    " float64[:, :, ::1])"
)
def _joined(
    nodes: NDArray[np.int64], steps: NDArray[np.int64], measured: Array, covariances: Array
) -> tuple[Array, Array]:
    motions = np.zeros((len(nodes), 3))
    found = np.zeros((len(nodes), 3, 3))
    adjoint = np.zeros((3, 3))
    for k in range(len(nodes)):
        motion, covariance = np.zeros(3), np.zeros((3, 3))
        for number in range(nodes[k] - steps[k] + 1, nodes[k] + 1):
            turn_back(measured[number], adjoint)
            covariance = adjoint @ covariance @ adjoint.T + covariances[number]
            _compose(motion, measured[number], motion)
        motions[k], found[k] = motion, covariance
    return motions, found


@compiled(
    "float64[:, ::1](int64[::1], int64[::1], float64[:, ::1], float64[:, :, ::1], float64[:, ::1])"
)
def _spread(
    nodes: NDArray[np.int64],
    steps: NDArray[np.int64],
    measured: Array,
    covariances: Array,
    poses: Array,
) -> Array:
    """Gauss-Newton steps for the errors of a chain's steps, whose sum its ends determine."""
    found = np.zeros((len(measured), 3))
    error, motion, adjoint = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for k in range(len(nodes)):
        last, count = nodes[k], steps[k]
        found[last] = poses[k]
        if count < 2:
            continue
        first = last - count
        errors, transports = np.zeros((count, 3)), np.zeros((count, 3, 3))
        way = np.zeros((count + 1, 3))
        way[0] = poses[k - 1]
        for _ in range(10):
            for i in range(count):
                _compose(measured[first + 1 + i], errors[i], motion)
                _compose(way[i], motion, way[i + 1])
            total, covariance = np.zeros(3), np.zeros((3, 3))
            for i in range(count):
                _relative(way[i + 1], way[count], motion)
                turn_back(motion, adjoint)
                transports[i] = adjoint
                total += adjoint @ errors[i]
                covariance += adjoint @ covariances[first + 1 + i] @ adjoint.T
            _relative(way[count], poses[k], error)
            if abs(error[0]) + abs(error[1]) + abs(error[2]) < 1e-9:
                break
            share = np.linalg.solve(covariance, total + error)
            for i in range(count):
                errors[i] = covariances[first + 1 + i] @ transports[i].T @ share
        for i in range(1, count):
            found[first + i] = way[i]
    return found
