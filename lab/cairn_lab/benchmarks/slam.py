"""Maps that SLAM builds: simulated drives in several worlds with four scanners, and real logs.

    python -m cairn_lab.benchmarks.slam [--worlds W,W] [--scanners UST-10LX] [LOG.clf.gz RELATIONS]
    python -m cairn_lab.benchmarks.slam --open-hall 3

Without a log, all worlds are driven with all scanners. A log of the SLAM benchmark (Kuemmerle
et al. 2009) is judged by its relations. `--open-hall` drives through an open hall with so many
seeds.
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cairn.components.replay_devices.carmen import CarmenRecording
from cairn.components.simulation.scanner import MODELS
from cairn.components.slam.mapping import Mapper
from cairn.planar.poses import Pose, relative
from cairn.planar.scans import rays_of
from cairn_lab.benchmarks.result import Metric
from tests.components.slam import courses
from tests.components.slam.courses import Course
from tests.components.slam.map_errors import islands_of, map_errors
from tests.components.slam.recordings import SCANNERS, OdometryErrors, Scanner, record

WORLDS: dict[str, Callable[[], Course]] = {
    "office": lambda: courses.shipped("office"),
    "hall": lambda: courses.shipped("hall"),
    "ward": lambda: courses.shipped("ward"),
    "ring": courses.ring,
    "corridor": courses.corridor,
    "large hall": courses.large_hall,
    "two wings": courses.two_wings,
}
FARTHEST_M = 30.0
LONG_RANGE = ("SICK", "UST-10LX")
RELATION_M, RELATION_DEG = 0.045, 0.54
"""What Cartographer reaches on fr079 (Hess et al. 2016)."""


def measure_world(world: str, scanner: str, seed: int = 0) -> list[Metric]:
    """Return the metrics of a simulated drive."""
    recording = record(WORLDS[world](), SCANNERS[scanner], seed)
    scans = zip(recording.stamps, recording.odometry, recording.rays, strict=True)
    mapper = Mapper(FARTHEST_M)
    begin = time.process_time()
    for stamp, odometry, rays in scans:
        mapper.add_scan(stamp, odometry, rays)
    live = time.process_time() - begin
    mapper.finish()
    spent = time.process_time() - begin
    errors = map_errors(mapper, recording)
    name = f"{world}, {scanner}"
    # Scanners that reach 3 to 4 m see nothing for long stretches of wide worlds.
    is_limited = scanner in LONG_RANGE
    return [
        Metric(f"{name}: largest position error", errors.worst_m, "m",
               at_most=0.5 if is_limited else None,
               note=f"relations {errors.relation_m:.3f} m, {errors.relation_deg:.2f} deg;"
               f" cells within 5 cm of a wall {errors.walls:.3f};"
               f" {len(islands_of(mapper))} islands"),
        Metric(f"{name}: speed", recording.seconds / spent, "x real time", at_least=20.0,
               note=f"{recording.seconds / live:.0f} while driving;"
               f" {len(mapper.keyframes)} keyframes"),
    ]  # fmt: skip


def measure_open_hall(reach_m: float, seed: int = 0) -> list[Metric]:
    """Return the metrics of an open hall, with a scanner of that reach and odometry 3 % too long.

    Of a reach of 4 m, a scan shows a bare wall, a pillar, or nothing.
    """
    scanner = Scanner(replace(MODELS["UST-10LX"], most=reach_m, noise_m=0.01), 2, 10.0)
    recording = record(courses.open_hall(), scanner, seed, OdometryErrors(scale=0.03))
    mapper = Mapper(FARTHEST_M)
    for stamp, odometry, rays in zip(
        recording.stamps, recording.odometry, recording.rays, strict=True
    ):
        mapper.add_scan(stamp, odometry, rays)
    mapper.finish()
    errors = map_errors(mapper, recording)
    name = f"open hall, reach of {reach_m:.0f} m, seed {seed}"
    least = 0.97 if reach_m >= 10.0 else 0.9
    return [
        Metric(f"{name}: cells within 10 cm of a wall", errors.walls_10cm, "", at_least=least,
               note=f"largest position error {errors.worst_m:.2f} m"),
    ]  # fmt: skip


def measure_log(log: Path, relations: Path) -> list[Metric]:
    """Return the metrics of a recorded log, by the relations of the SLAM benchmark."""
    begin = time.process_time()
    mapper, times = map_log(log, FARTHEST_M)
    spent = time.process_time() - begin
    found = [(x, y, theta) for x, y, theta in mapper.poses().tolist()]
    meters, degrees = relation_errors(times, found, relations)
    seconds = (times[-1] - times[0]) / 1e9
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return [
        Metric(f"{log.name}: error of the relations", float(np.mean(meters)), "m",
               at_most=RELATION_M, note=f"{len(meters)} relations"),
        Metric(f"{log.name}: error of their headings", float(np.mean(degrees)), "deg",
               at_most=RELATION_DEG),
        Metric(f"{log.name}: speed", seconds / spent, "x real time", at_least=20.0,
               note=f"{len(mapper.keyframes)} keyframes, {memory:.0f} MiB at most"),
    ]  # fmt: skip


def map_log(log: Path, farthest: float, seconds: float = math.inf) -> tuple[Mapper, list[int]]:
    """Map a log, or its first `seconds` [s]; return the finished map and the scans' times [ns]."""
    recording = CarmenRecording(log, 0.0)
    track = recording.odometry()
    scans = recording.scans()
    if track is None or scans is None:
        raise ValueError(f"{log} has no odometry or no scans")
    stamps, poses = np.array(track.stamps), track.poses.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    mapper = Mapper(farthest)
    times: list[int] = []
    for stamp, scan in zip(scans.stamps, scans.messages, strict=True):
        if times and stamp - times[0] > seconds * 1e9:
            break
        x, y, theta = (float(np.interp(stamp, stamps, column)) for column in poses.T)
        mapper.add_scan(stamp, (x, y, theta), rays_of(scan, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
        times.append(stamp)
    mapper.finish()
    return mapper, times


def relation_errors(
    times: Sequence[int], poses: Sequence[Pose], relations: Path
) -> tuple[list[float], list[float]]:
    """Return the errors [m], [degrees] of relations: two times, x, y, ..., heading."""
    number = {round(stamp / 1e3): k for k, stamp in enumerate(times)}
    meters, degrees = [], []
    for line in relations.read_text("ascii").splitlines():
        words = line.split()
        first, second = (number.get(round(float(word) * 1e6)) for word in words[:2])
        if first is None or second is None:
            continue
        expected = (float(words[2]), float(words[3]), float(words[7]))
        error = relative(expected, relative(poses[first], poses[second]))
        meters.append(math.hypot(error[0], error[1]))
        degrees.append(abs(math.degrees(error[2])))
    return meters, degrees


def measure(
    worlds: Sequence[str] = tuple(WORLDS), scanners: Sequence[str] = tuple(SCANNERS)
) -> list[Metric]:
    """Return the metrics of all worlds with all scanners."""
    return [
        metric
        for world in worlds
        for scanner in scanners
        for metric in measure_world(world, scanner)
    ]


def _metrics(arguments: argparse.Namespace) -> Iterator[Metric]:
    if arguments.log:
        log, relations = arguments.log
        yield from measure_log(log, relations)
        return
    if arguments.open_hall:
        for reach_m in (10.0, 4.0):
            for seed in range(arguments.open_hall):
                yield from measure_open_hall(reach_m, seed)
        return
    for world in arguments.worlds.split(","):
        for scanner in arguments.scanners.split(","):
            yield from measure_world(world, scanner)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="*", type=Path, help="a log and its relations")
    parser.add_argument("--worlds", default=",".join(WORLDS))
    parser.add_argument("--scanners", default=",".join(SCANNERS))
    parser.add_argument("--open-hall", type=int, metavar="SEEDS", help="an open hall instead")
    for f in _metrics(parser.parse_args()):
        verdict = "" if not f.limit else ("kept" if f.kept else "MISSED")
        print(f"{f.name}: {f.value:.3g} {f.unit} ({f.limit} {verdict}) {f.note}", flush=True)


if __name__ == "__main__":
    main()
