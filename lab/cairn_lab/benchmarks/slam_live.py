"""SLAM at bounded cost: processor time of the live component, and an hour of mapping in memory.

    python -m cairn_lab.benchmarks slam_live
    python -m cairn_lab.benchmarks.slam_live [--live HZ] [--hour COURSE] [--seconds S]

Live, real processes: the simulated robot explores the office with a scanner of 1,081 beams, and the
processor time of the process `slam` is compared with the time that passes. The hour is one of
virtual time: the component in lockstep, in a process of its own, with drives through a building
whose rooms the robot visits again and again (`two wings`), and through a large one (`large ring`).
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import psutil

import cairn.client
from cairn import from_ns
from cairn.components.simulation.scanner import MODELS
from cairn.components.slam.component import Slam
from cairn.deployment.shipped import FOLDER
from cairn.planar.messages import pose_message
from cairn.planar.poses import Pose
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.testing.launching import Run, launching
from cairn.testing.lockstep import ComponentHarness
from cairn_lab.benchmarks.result import Metric
from tests.components.slam import courses
from tests.components.slam.courses import Course
from tests.components.slam.recordings import Scanner, sweeps

RATES_HZ = (10, 40)
LIVE_S, HOUR_S = 240.0, 3600.0
_PERIOD_S = 10.0
_SCANNER = Scanner(replace(MODELS["UST-10LX"], noise_m=0.01), skip=1, rate=10.0)
_MOST_LOAD, _MOST_MIB = 50.0, 500.0
_OUTPUTS = ("map", "map_updates", "localization", "pose", "tf")


def repeated(course: Course, times: int) -> Course:
    """Return a course that is driven several times in succession."""
    return Course(course.world, times * course.stops)


COURSES: dict[str, Callable[[], Course]] = {
    "two wings": lambda: repeated(courses.two_wings(), 7),
    "large ring": lambda: courses.ring(rooms=12, turns=3.0),
}


@dataclass(frozen=True)
class LiveLoad:
    """The load of the process `slam` while the robot explores.

    Attributes:
        shares: processor time over time of each period of 10 s [1].
        peak_mib: most memory of the process [MiB], with what it shares with others.
        keyframes: of the map in the end.
        received: scans.
        dropped: scans that were dropped because slam was busy.

    """

    shares: list[float]
    peak_mib: float
    keyframes: int
    received: int
    dropped: int


@dataclass(frozen=True)
class Hour:
    """The cost of a long drive.

    Attributes:
        seconds: duration of the drive [s].
        driven_m: its length [m].
        shares: processor time over virtual time of each tenth of the drive [1].
        longest_ms: longest call of a handler [ms].
        start_mib: memory of the process before the first scan [MiB].
        peak_mib: most memory [MiB].
        keyframes: of the map in the end.
        loops: closed.

    """

    seconds: float
    driven_m: float
    shares: list[float]
    longest_ms: float
    start_mib: float
    peak_mib: float
    keyframes: int
    loops: int


def measure_live(rate: int, seconds: float = LIVE_S) -> LiveLoad:
    """Let the robot explore the office for so long with a scanner of this rate [1/s]."""
    sets = {
        "settings.world": FOLDER / "worlds" / "office.yaml",
        "settings.explore": "on_activation",
        "components.mobile_supervisor.children.range_scanner.parameters.rate": rate,
        "components.mobile_supervisor.children.range_scanner.parameters.skip": 1,
    }
    arguments = [word for key, value in sets.items() for word in ("--set", f"{key}={value}")]
    with tempfile.TemporaryDirectory() as folder, launching(Path(folder)) as launch:
        run = launch(FOLDER / "mapping.yaml", "--plain", *arguments)
        run.await_line("child active: mobile_supervisor")
        return _sampled(run, seconds)


def _sampled(run: Run, seconds: float) -> LiveLoad:
    process = psutil.Process(run.pid_of("slam"))
    shares, peak = [], 0.0
    begin, used = time.monotonic(), _used_s(process)
    end = begin + seconds
    while time.monotonic() < end:
        time.sleep(_PERIOD_S)  # the benchmark measures intervals of time
        before, used_before = begin, used
        begin, used = time.monotonic(), _used_s(process)
        shares.append((used - used_before) / (begin - before))
        peak = max(peak, process.memory_info().rss / 2**20)
    with cairn.client.connect(run.endpoint) as robot:
        keyframes = int(robot.request("slam", "status")["keyframes"])
        (scan,) = (port for port in robot.components()["slam"].ports if port.port == "scan")
    return LiveLoad(shares, peak, keyframes, scan.messages, scan.dropped)


def _used_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def measure_hour(course: str, seconds: float = HOUR_S) -> Hour:
    """Map a long drive in this process, whose memory is measured."""
    with tempfile.TemporaryDirectory() as folder:
        slam = ComponentHarness(Slam, {"map_file": f"{folder}/map.yaml"}, start_s=100.0)
        start_mib = psutil.Process().memory_info().rss / 2**20
        spent = [0.0] * 10
        longest = driven = 0.0
        last: Pose | None = None
        duration = 0.0
        for sweep in sweeps(COURSES[course](), _SCANNER):
            duration = sweep.end_ns / 1e9
            if duration > seconds:
                break
            if last is not None:
                driven += ((sweep.truth[0] - last[0]) ** 2 + (sweep.truth[1] - last[1]) ** 2) ** 0.5
            last = sweep.truth
            begin = time.process_time()
            for at_ns, pose in ((sweep.start_ns, sweep.start), (sweep.end_ns, sweep.end)):
                slam.run_to(100 * 10**9 + at_ns)
                stamp = from_ns(slam.now_ns)
                odometry = Odometry(
                    header=Header(stamp=stamp, frame_id="odom"),
                    child_frame_id="base_link",
                    pose=PoseWithCovariance(pose=pose_message(pose)),
                )
                slam.publish("odom", odometry)
            first_beam = from_ns(100 * 10**9 + sweep.start_ns)
            header = Header(stamp=first_beam, frame_id="laser")
            slam.publish("scan", replace(sweep.scan, header=header))
            took = time.process_time() - begin
            spent[min(9, int(10 * duration / seconds))] += took
            longest = max(longest, took)
            for port in _OUTPUTS:
                slam.take(port)
            slam.published.clear()
        status = slam.request("status")
        slam.request("deactivate")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Hour(
        seconds=duration,
        driven_m=driven,
        shares=[10 * one / seconds for one in spent],
        longest_ms=1e3 * longest,
        start_mib=start_mib,
        peak_mib=peak,
        keyframes=status["keyframes"],
        loops=status["loops"],
    )


def _hour_in_process(course: str, seconds: float) -> Hour:
    command = [sys.executable, "-m", "cairn_lab.benchmarks.slam_live", "--hour", course]
    command += ["--seconds", str(seconds), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")
    return Hour(**json.loads(done.stdout.splitlines()[-1]))


def live_metrics(rate: int, found: LiveLoad) -> list[Metric]:
    """Return the metrics of a live drive."""
    name = f"slam live, 1,081 beams at {rate} Hz"
    third = max(1, len(found.shares) // 3)
    first, last = statistics.mean(found.shares[:third]), statistics.mean(found.shares[-third:])
    return [
        Metric(f"{name}: of one core", 100.0 * statistics.mean(found.shares), "%",
               at_most=_MOST_LOAD,
               note=f"most in {_PERIOD_S:g} s: {100 * max(found.shares):.0f} %; first third"
               f" {100 * first:.0f} %, last {100 * last:.0f} %; {found.keyframes} keyframes"),
        Metric(f"{name}: scans dropped", float(found.dropped), "",
               at_most=0 if rate == RATES_HZ[0] else None, note=f"of {found.received}"),
        Metric(f"{name}: memory of the process", found.peak_mib, "MiB", at_most=_MOST_MIB),
    ]  # fmt: skip


def hour_metrics(course: str, found: Hour) -> list[Metric]:
    """Return the metrics of a long drive."""
    name = f"{course}, {found.seconds / 60:.0f} min"
    per_meter = 1024 * (found.peak_mib - found.start_mib) / found.driven_m
    return [
        Metric(f"{name}: memory of the process", found.peak_mib, "MiB", at_most=_MOST_MIB,
               note=f"{found.start_mib:.0f} MiB before; {per_meter:.0f} kB per meter of"
               f" {found.driven_m:.0f}; {found.keyframes} keyframes, {found.loops} loops"),
        Metric(f"{name}: of one core", 100.0 * max(found.shares), "%", at_most=_MOST_LOAD,
               note="most in a tenth of the time; tenths: "
               + " ".join(f"{100 * one:.1f}" for one in found.shares)),
        Metric(f"{name}: longest call", found.longest_ms, "ms", at_most=500.0),
    ]  # fmt: skip


def measure() -> list[Metric]:
    """Return the metrics of the live drives and of the hours."""
    return [
        *(metric for rate in RATES_HZ for metric in live_metrics(rate, measure_live(rate))),
        *(
            metric
            for course in COURSES
            for metric in hour_metrics(course, _hour_in_process(course, HOUR_S))
        ),
    ]


def _metrics(arguments: argparse.Namespace) -> Iterator[Metric]:
    if arguments.live:
        seconds = arguments.seconds or LIVE_S
        yield from live_metrics(arguments.live, measure_live(arguments.live, seconds))
    if arguments.hour:
        seconds = arguments.seconds or HOUR_S
        yield from hour_metrics(arguments.hour, _hour_in_process(arguments.hour, seconds))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--live", type=int, metavar="HZ", help="scans per second")
    parser.add_argument("--hour", choices=COURSES, help="course of the long drive")
    parser.add_argument("--seconds", type=float, help="duration [s]")
    parser.add_argument("--json", action="store_true", help="the hour in this process, as JSON")
    arguments = parser.parse_args()
    if arguments.json:
        print(json.dumps(asdict(measure_hour(arguments.hour, arguments.seconds or HOUR_S))))
        return
    for f in _metrics(arguments):
        verdict = "" if not f.limit else ("kept" if f.kept else "MISSED")
        print(f"{f.name}: {f.value:.3g} {f.unit} ({f.limit} {verdict}) {f.note}", flush=True)


if __name__ == "__main__":
    main()
