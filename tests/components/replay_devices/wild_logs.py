"""Logs as they are in the wild: a clean synthetic drive, and the defects that real loggers cause.

The office of `deploy/worlds` is driven through at 0.5 m/s with a SICK laser of 5 scans per second.
The defects are those of the well-known log of the Intel lab: ODOM lines with times up to 0.3 s off,
scans that come in bursts within 20 ms, gaps of 1 to 2 s, repeated lines, and bad ones.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.ray_casting import cast
from cairn.components.simulation.world_file import read_world
from cairn.planar.poses import Pose, compose, relative, wrap

Array = NDArray[np.float64]

OFFICE = Path(__file__).parents[3] / "deploy" / "worlds" / "office.yaml"
START: Pose = (1.0, 6.0, 0.0)
ORIGIN_S = 976052857.0  # a time with as many digits as today's
MOUNT: Pose = (0.1, 0.0, 0.0)
STEP_S, ODOM_EVERY, SCAN_EVERY = 0.05, 2, 4  # 10 odometry records and 5 scans per second
_WAY = ((7.0, 6.0), (7.0, 2.5), (7.0, 6.0), (16.0, 6.0), (16.0, 8.6), (16.0, 6.0), (12.0, 6.0),
        (12.0, 3.5), (12.0, 6.0), (3.0, 6.0), (3.0, 8.2), (3.0, 6.0), (2.0, 6.0))  # fmt: skip
_SPEED, _TURN = 0.5, 0.9
_BEAMS = 180
_NO_CIRCLES = np.zeros((0, 3))


@dataclass(frozen=True)
class Drive:
    """True poses and odometry (n, 3) every `STEP_S`, and the ranges [m] of scans at some steps."""

    truth: Array
    odometry: Array
    scans: dict[int, Array]


@cache
def office_drive(mount: Pose = MOUNT) -> Drive:
    """Drive through the office with a scanner at `mount`; odometry has errors of 2 %."""
    truth = _true_poses()
    segments = np.ascontiguousarray(WorldLayout.of(read_world(OFFICE)).solid_segments.segments)
    random = np.random.default_rng(7)
    odometry: list[Pose] = [(0.0, 0.0, 0.0)]
    for before, after in pairwise(truth):
        x, y, turn = relative(before, after)
        step = (1.02 * x, y, 1.01 * turn + 0.01 * x + 0.002 * abs(x) * random.normal())
        odometry.append(compose(odometry[-1], step))
    bearings = np.radians(np.arange(_BEAMS) - 90.0)
    scans = {}
    for k in range(0, len(truth), SCAN_EVERY):
        x, y, theta = compose(truth[k], mount)
        starts = np.tile([x, y], (_BEAMS, 1))
        ranges, _ = cast(starts, bearings + theta, segments, _NO_CIRCLES, 50.0)
        scans[k] = np.round(ranges + random.normal(0.0, 0.01, _BEAMS), 2)
    return Drive(np.array(truth), np.array(odometry), scans)


def _true_poses() -> list[Pose]:
    poses = [START] * round(2.0 / STEP_S)
    for goal in _WAY:
        while math.hypot(goal[0] - poses[-1][0], goal[1] - poses[-1][1]) > 0.05:
            x, y, theta = poses[-1]
            off = wrap(math.atan2(goal[1] - y, goal[0] - x) - theta)
            turn = max(-_TURN, min(_TURN, 3.0 * off))
            forward = _SPEED if abs(off) < 0.3 else 0.0
            poses.append(compose(poses[-1], (forward * STEP_S, 0.0, turn * STEP_S)))
    return [*poses, *[poses[-1]] * round(2.0 / STEP_S)]


@dataclass(frozen=True)
class Defects:
    """What is wrong with a log; the default is a log of which the times alone are wrong.

    `disorder_s` is how far times of ODOM lines may be off, `disordered` which share of them.
    A stall delays the scans of `stall_s`, which then come in a burst; `gaps` [s] are left out.
    `own_clock`: whether the logger's times are those of its own, even clock.
    """

    disorder_s: float = 0.3
    disordered: float = 0.3
    stall_every_s: float = 10.0
    stall_s: float = 0.9
    gaps: tuple[tuple[float, float], ...] = ((30.0, 1.0), (60.0, 2.0), (90.0, 1.5))
    repeated: float = 0.01
    bad_lines: bool = True
    own_clock: bool = False


NONE = Defects(disorder_s=0.0, stall_s=0.0, gaps=(), repeated=0.0, bad_lines=False)


@dataclass(frozen=True)
class WildLog:
    """The lines of a log; `scan_steps` are the drive's steps of its scans, in the true order."""

    lines: list[str]
    scan_steps: list[int] = field(default_factory=list)


def wild_log(
    drive: Drive, kind: str, defects: Defects, seed: int = 1, mount: Pose = MOUNT
) -> WildLog:
    """Return the log of a drive with laser lines of `kind`: FLASER, ROBOTLASER1 or RAWLASER1."""
    random = np.random.default_rng(seed)
    lines: list[tuple[float, str]] = []  # with the time at which the logger wrote them
    steps: list[int] = []
    last_sent = 0.0
    for k in range(0, len(drive.truth), min(ODOM_EVERY, SCAN_EVERY)):
        at = k * STEP_S
        if any(begin <= at < begin + length for begin, length in defects.gaps):
            continue
        pose = tuple(drive.odometry[k].tolist())
        if k % ODOM_EVERY == 0:
            off = 0.0
            if random.random() < defects.disordered:
                off = random.uniform(-defects.disorder_s, defects.disorder_s)
            lines.append((at, _odom(drive, k, at + off, at if defects.own_clock else at + off)))
        if k in drive.scans:
            sent = at
            into = at % defects.stall_every_s
            if into < defects.stall_s:
                # The scans of a stall are sent within 20 ms at its end.
                sent = at - into + defects.stall_s + 0.02 * into / defects.stall_s
            sent = max(sent, last_sent) + random.uniform(0.0, 0.001)  # none overtakes another
            last_sent = sent
            steps.append(k)
            logged = at if defects.own_clock else sent
            lines.append((sent, _scan(kind, drive.scans[k], pose, mount, sent, logged)))
    lines.sort(key=lambda entry: entry[0])
    texts = []
    for _, text in lines:
        texts += [text] * (2 if random.random() < defects.repeated else 1)
    if defects.bad_lines:
        texts.insert(100, "ODOM nan 0 0 0 0 0 976052860 nohost 3.0")
        texts.append("ODOM 0 0 0 0 0 0 0 nohost 0")
        texts.append(texts[-2][: len(texts[-2]) // 2])  # cut off
    return WildLog(texts, steps)


def _odom(drive: Drive, k: int, at: float, logged: float) -> str:
    x, y, theta = drive.odometry[k].tolist()
    nearby = drive.odometry[[max(k - 1, 0), k]].tolist()
    ahead, _, turned = relative(tuple(nearby[0]), tuple(nearby[1]))
    return (
        f"ODOM {x:.6f} {y:.6f} {theta:.6f} {ahead / STEP_S:.6f} {turned / STEP_S:.6f} 0 "
        f"{ORIGIN_S + at:.6f} nohost {logged + 5.0:.6f}"
    )


def _scan(kind: str, ranges: Array, robot: Pose, mount: Pose, at: float, logged: float) -> str:
    poses = " ".join(f"{value:.6f}" for value in (*compose(robot, mount), *robot))
    beams = f"{len(ranges)} " + " ".join(f"{r:.2f}" for r in ranges.tolist())
    stamp = f"{ORIGIN_S + at:.6f} nohost {logged + 5.0:.6f}"
    if kind == "FLASER":
        return f"FLASER {beams} {poses} {stamp}"
    step = math.radians(1.0)
    laser = f"{kind} 0 {-math.pi / 2:.6f} {179 * step:.6f} {step:.6f} 81.0 0.01 0 {beams} 0"
    return f"{laser} {stamp}" if kind == "RAWLASER1" else f"{laser} {poses} 0 0 0 0 0 {stamp}"
