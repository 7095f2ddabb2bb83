"""Corrects the poses of a CARMEN log by manually verified relations between them.

    python -m cairn_lab.benchmarks.corrected_poses LOG RELATIONS OUT [--apart 0.3] [--turned 0.2]

A pose graph is solved by least squares: one node for each scan, edges by the relations (of the
SLAM benchmark of R. Kuemmerle et al., Autonomous Robots 27(4), 2009) and by odometry between
successive scans. It grows scan by scan, so that each loop is closed before much drift has
accumulated. Relations are treated as relations of robot poses: these give the sharpest maps of
fr079. OUT is a CARMEN log (gzipped) whose FLASER lines have the corrected pose in both pose fields,
the laser's and the robot's; ODOM lines are the raw ones, and so are all times. Scans closer to the
last one than --apart [m], --turned [rad] and --after [s] are left out. With --delay [s] odometry is
taken from so long before a scan's time: the delay at which odometry and relations agree best.
"""

from __future__ import annotations

import argparse
import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import spsolve

from cairn.components.replay_devices.bounded_streams import text_lines
from cairn.components.replay_devices.carmen_lines import LaserLine, read_log
from cairn.components.replay_devices.carmen_odometry import restore_driving_direction
from cairn.planar.poses import compose, wrap, wrap_all

Array = NDArray[np.float64]

# Standard deviations: a relation's [m, rad]; odometry's at least, and per meter and radian.
# Where this robot maneuvered, its odometry reports turns that it did not make: relations win.
_RELATION = (0.02, 0.007)
_STEP = (0.01, 0.01)
_PER_M, _PER_RAD = (0.05, 0.05), (0.02, 0.1)


@dataclass(frozen=True)
class Edges:
    """Node `b` relative to node `a`: `measured` (n, 3) [m, m, rad] with `weights` (n, 3)."""

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    measured: Array
    weights: Array


def relations_of(path: Path, times: Array) -> Edges:
    """Read the relations whose two times are times of scans: t1 t2 x y z roll pitch yaw."""
    rows = np.array([[float(word) for word in text.split()] for _, text in text_lines(path)])
    a, b = (np.abs(times[None, :] - rows[:, k, None]).argmin(axis=1) for k in (0, 1))
    met = (np.abs(times[a] - rows[:, 0]) < 1e-3) & (np.abs(times[b] - rows[:, 1]) < 1e-3)
    position, turn = _RELATION
    weights = np.tile([position**-2, position**-2, turn**-2], (int(met.sum()), 1))
    return Edges(a[met], b[met], rows[met][:, [2, 3, 7]], weights)


def odometry_of(poses: Array) -> Edges:
    """Return the edges by odometry between successive scans."""
    a = np.arange(len(poses) - 1)
    measured = relative(poses[:-1], poses[1:])
    distance, turn = np.hypot(measured[:, 0], measured[:, 1]), np.abs(measured[:, 2])
    position_sd = _STEP[0] + _PER_M[0] * distance + _PER_RAD[0] * turn
    turn_sd = _STEP[1] + _PER_M[1] * distance + _PER_RAD[1] * turn
    return Edges(a, a + 1, measured, np.column_stack((position_sd, position_sd, turn_sd)) ** -2)


def relative(origins: Array, poses: Array) -> Array:
    """Return `poses` (n, 3) relative to `origins` (n, 3)."""
    dx, dy = poses[:, 0] - origins[:, 0], poses[:, 1] - origins[:, 1]
    cosine, sine = np.cos(origins[:, 2]), np.sin(origins[:, 2])
    return np.column_stack(
        (cosine * dx + sine * dy, cosine * dy - sine * dx, wrap_all(poses[:, 2] - origins[:, 2]))
    )


def residuals(poses: Array, edges: Edges) -> Array:
    """Return the differences (n, 3) between the poses and the edges."""
    apart = relative(poses[edges.a], poses[edges.b]) - edges.measured
    apart[:, 2] = wrap_all(apart[:, 2])
    return apart


def grown(odometry: Edges, relations: Edges, every: int = 100) -> Array:
    """Return the best poses (n, 3), the first at the origin; `every` nodes are added at once."""
    count = len(odometry.a) + 1
    poses = np.zeros((1, 3))
    latest = np.maximum(relations.a, relations.b)
    while len(poses) < count:
        size = min(len(poses) + every, count)
        for k in range(len(poses) - 1, size - 1):
            step = odometry.measured[k].tolist()
            poses = np.vstack((poses, compose(tuple(poses[k].tolist()), tuple(step))))
        known = [chosen(odometry, odometry.b < size), chosen(relations, latest < size)]
        poses = solve(poses, known, 60 if size == count else 6)
    return poses


def solve(poses: Array, graph: list[Edges], rounds: int) -> Array:
    """Return the best poses (n, 3) for the edges (Gauss-Newton, damped); the first is fixed."""
    damping = 1e-6
    cost = _cost(poses, graph)
    for _ in range(rounds):
        hessian, gradient = _normal(poses, graph)
        diagonal = csc_matrix((hessian.diagonal() * damping, (range(len(gradient)),) * 2))
        tried = poses + spsolve((hessian + diagonal).tocsc(), -gradient).reshape(-1, 3)
        better = _cost(tried, graph)
        if better < cost:
            done = cost - better < 1e-7 * cost
            poses, cost, damping = tried, better, damping / 10
            if done:
                break
        else:
            damping = max(10 * damping, 1e-6)
    poses[:, 2] = wrap_all(poses[:, 2])
    return poses


def chosen(edges: Edges, which: NDArray[np.bool_]) -> Edges:
    """Return some of the edges."""
    return Edges(edges.a[which], edges.b[which], edges.measured[which], edges.weights[which])


def _cost(poses: Array, graph: list[Edges]) -> float:
    return sum(float((e.weights * residuals(poses, e) ** 2).sum()) for e in graph)


def _normal(poses: Array, graph: list[Edges]) -> tuple[csc_matrix, Array]:
    size = 3 * len(poses)
    rows, columns, values = [], [], []
    gradient = np.zeros(size)
    for e in graph:
        apart = residuals(poses, e)
        at_a, at_b = _jacobians(poses, e)
        nodes = ((e.a, at_a), (e.b, at_b))
        for node, jacobian in nodes:
            part = np.einsum("nki,nk->ni", jacobian, e.weights * apart)
            np.add.at(gradient, (3 * node[:, None] + np.arange(3)), part)
            for other, beside in nodes:
                block = np.einsum("nki,nk,nkj->nij", jacobian, e.weights, beside)
                row, column = np.broadcast_arrays(
                    3 * node[:, None, None] + np.arange(3)[None, :, None],
                    3 * other[:, None, None] + np.arange(3)[None, None, :],
                )
                rows.append(row.ravel())
                columns.append(column.ravel())
                values.append(block.ravel())
    rows.append(np.arange(3))  # fixes the first pose
    columns.append(np.arange(3))
    values.append(np.full(3, 1e12))
    position = (np.concatenate(rows), np.concatenate(columns))
    return csc_matrix((np.concatenate(values), position), shape=(size, size)), gradient


def _jacobians(poses: Array, edges: Edges) -> tuple[Array, Array]:
    """Return derivatives (n, 3, 3) of the residuals by the pose `a` and by the pose `b`."""
    a, b = poses[edges.a], poses[edges.b]
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    cosine, sine = np.cos(a[:, 2]), np.sin(a[:, 2])
    at_b = np.zeros((len(a), 3, 3))
    at_b[:, 0, 0], at_b[:, 0, 1] = cosine, sine
    at_b[:, 1, 0], at_b[:, 1, 1] = -sine, cosine
    at_b[:, 2, 2] = 1.0
    at_a = -at_b
    at_a[:, 0, 2] = -sine * dx + cosine * dy
    at_a[:, 1, 2] = -cosine * dx - sine * dy
    return at_a, at_b


def thinned(times: Array, poses: Array, apart: float, turned: float, after: float) -> list[int]:
    """Return indices of poses that differ from the last kept one by [m], [rad] or [s]."""
    kept = [0]
    for k in range(1, len(poses)):
        moved = poses[k] - poses[kept[-1]]
        far = math.hypot(moved[0], moved[1]) >= apart or abs(wrap(moved[2])) >= turned
        if far or times[k] - times[kept[-1]] >= after:
            kept.append(k)
    return kept


def write_log(path: Path, source: Path, lasers: list[LaserLine], poses: dict[int, Array]) -> None:
    """Write the parameters, the ODOM lines and those FLASER lines of `source` that have a pose.

    `poses` are the corrected robot poses, by line number.
    """
    mounts = {line.line: line for line in lasers}
    written = [
        "# Poses corrected by cairn_lab/benchmarks/corrected_poses.py: both of each FLASER line.\n"
    ]
    for number, text in text_lines(source):
        if number in poses:
            words = text.split()
            count = int(words[1])
            robot = (float(poses[number][0]), float(poses[number][1]), float(poses[number][2]))
            line = mounts[number]
            assert line.laser is not None
            assert line.robot is not None
            mount = relative(np.array([line.robot]), np.array([line.laser]))[0].tolist()
            laser = compose(robot, (round(mount[0], 4), round(mount[1], 4), mount[2]))
            words[2 + count : 8 + count] = [f"{value:.4f}" for value in (*laser, *robot)]
            written.append(" ".join(words) + "\n")
        elif text.split(maxsplit=1)[0:1] != ["FLASER"]:
            written.append(text)
    with gzip.GzipFile(path, "wb", compresslevel=9, mtime=0) as stream:
        stream.write("".join(written).encode("ascii"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("relations", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--apart", type=float, default=0.3, help="meters between scans kept")
    parser.add_argument("--turned", type=float, default=0.2, help="radians between scans kept")
    parser.add_argument("--after", type=float, default=1.0, help="seconds between scans kept")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds scans are stamped late")
    args = parser.parse_args()
    log = read_log(args.log)
    lasers = log.lasers["FLASER"]
    times = np.array([line.time for line in lasers])
    wheels = restore_driving_direction(log.odometry).lines
    odometry = np.array([line.pose for line in wheels])
    odometry_at = np.array([line.time for line in wheels])
    turned = np.unwrap(odometry[:, 2])
    moments = times - args.delay
    columns = (odometry[:, 0], odometry[:, 1], turned)
    raw = np.column_stack([np.interp(moments, odometry_at, column) for column in columns])
    start = relative(np.repeat(raw[:1], len(raw), axis=0), raw)
    relations = relations_of(args.relations, times)
    poses = grown(odometry_of(raw), relations)
    for name, these in (("odometry", start), ("corrected", poses)):
        off = residuals(these, relations)
        position = np.hypot(off[:, 0], off[:, 1])
        print(
            f"{name}: {len(off)} relations, position error {position.mean():.4f} m on average, "
            f"{np.sqrt((position**2).mean()):.4f} m rms, at most {position.max():.3f} m; "
            f"heading {np.degrees(np.abs(off[:, 2]).mean()):.3f} degrees on average, "
            f"at most {np.degrees(np.abs(off[:, 2]).max()):.2f}"
        )
    kept = thinned(times, poses, args.apart, args.turned, args.after)
    write_log(args.out, args.log, lasers, {lasers[k].line: poses[k] for k in kept})
    print(f"{args.out}: {len(kept)} of {len(lasers)} scans, {args.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
