"""The simulated world: rays per second on one core, and time of a simulated second in lockstep."""

import math
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.qos import SENSOR
from cairn.components.simulation.base import SimulatedBase
from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.ray_casting import cast
from cairn.components.simulation.recognizer import SimulatedRecognizer
from cairn.components.simulation.scanner import SimulatedScanner
from cairn.components.simulation.world_component import SimulatedWorld
from cairn.components.simulation.world_file import read_world
from cairn.processes.lockstep import LockstepExecutor
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.component import Component
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import Transition
from cairn.runtime.process_exit import ExitReport
from cairn.runtime.runtime import Runtime
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.system.clock import SECOND
from cairn_lab.benchmarks.result import Metric

Array = NDArray[np.float64]
WORLDS = Path(__file__).parents[3] / "deploy" / "worlds"
RANGE_M = 10.0


def in_python(x: float, y: float, angle: float, segments: list[list[float]]) -> float:
    """Return the range [m] of one ray against segments, in plain Python."""
    cosine, sine = math.cos(angle), math.sin(angle)
    best = RANGE_M
    for x1, y1, x2, y2 in segments:
        dx, dy = x2 - x1, y2 - y1
        across = cosine * dy - sine * dx
        if across == 0.0:
            continue
        along = ((x1 - x) * dy - (y1 - y) * dx) / across
        share = ((x1 - x) * sine - (y1 - y) * cosine) / across
        if 0.0 <= share <= 1.0 and 0.0 <= along < best:
            best = along
    return best if best < RANGE_M else math.inf


def in_numpy(starts: Array, angles: Array, segments: Array) -> Array:
    """Return the ranges of all rays against all segments at once."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x1, y1 = segments[:, 0] - starts[:, :1], segments[:, 1] - starts[:, 1:]
    dx, dy = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = cosine * dy - sine * dx
        along = (x1 * dy - y1 * dx) / across
        share = (x1 * sine - y1 * cosine) / across
    along[~((share >= 0.0) & (share <= 1.0) & (along >= 0.0) & (along < RANGE_M))] = math.inf
    nearest: Array = along.min(axis=1)
    return nearest


def rays() -> list[Metric]:
    """Measure sweeps of 1081 rays from random positions in the hall."""
    segments = WorldLayout.of(read_world(WORLDS / "hall.yaml")).solid_segments.segments
    no_people = np.zeros((0, 3))
    random = np.random.default_rng(0)
    sweeps = 40
    starts = random.uniform((0.5, 1.0), (19.5, 14.5), (sweeps, 2)).repeat(1081, axis=0)
    angles = np.tile(np.linspace(-math.pi, math.pi, 1081), sweeps)
    ranges, _ = cast(starts, angles, segments, no_people, RANGE_M)
    began = time.process_time()
    for _ in range(20):
        cast(starts, angles, segments, no_people, RANGE_M)
    rate = 20 * angles.size / (time.process_time() - began)
    began = time.process_time()
    vectorized = np.concatenate(
        [
            in_numpy(starts[one : one + 1081], angles[one : one + 1081], segments)
            for one in range(0, angles.size, 1081)
        ]
    )
    numpy_rate = angles.size / (time.process_time() - began)
    count, rows = 4000, segments.tolist()
    began = time.process_time()
    plain = [
        in_python(x, y, angle, rows)
        for (x, y), angle in zip(starts[:count].tolist(), angles[:count].tolist(), strict=True)
    ]
    python_rate = count / (time.process_time() - began)
    wrong = np.sum(~np.isclose(ranges, vectorized, atol=1e-9))
    wrong += np.sum(~np.isclose(ranges[:count], plain, atol=1e-9))
    return [
        Metric("hall: rays per second", rate / 1e6, "million", at_least=2),
        Metric("hall: times as fast as numpy", rate / numpy_rate, "x", at_least=3,
               note=f"numpy {numpy_rate / 1e6:.2g} million"),
        Metric("hall: times as fast as a loop in Python", rate / python_rate, "x", at_least=50,
               note=f"Python {python_rate / 1e3:.2g} thousand"),
        Metric("hall: rays with different results", float(wrong), "", at_most=0),
    ]  # fmt: skip


def simulated(world: str, seconds: float) -> float:
    """Return the CPU ms per simulated second of world, base, scanner and recognizer in a curve."""
    executor, bus, ends = LockstepExecutor(SECOND), LockstepBus(), list[ExitReport]()
    parts: dict[str, tuple[type[Component], dict[str, object]]] = {
        "world": (SimulatedWorld, {"world": str(WORLDS / world)}),
        "base": (SimulatedBase, {}),
        "range_scanner": (SimulatedScanner, {"rate": 10, "skip": 3}),
        "object_recognizer": (SimulatedRecognizer, {}),
    }
    for name, (component, parameters) in parts.items():
        runtime = Runtime(
            component,
            LaunchRequest(name=name, spec=ChildSpec(plugin=name, parameters=parameters)),
            bus,
            executor.scheduler(),
            executor,
            ends.append,
        )
        runtime.transition(Transition.CONFIGURE)
        runtime.transition(Transition.ACTIVATE)
    writer = bus.node("/robot/driver", _ignore).advertise("/robot/cmd_vel", Twist, SENSOR)
    command = Twist(linear=Vector3(x=0.3), angular=Vector3(z=1.2))

    def drive() -> None:
        writer.publish(command)
        executor.at(executor.now() + SECOND // 10, drive)

    drive()
    began, until = time.process_time(), executor.now() + round(seconds * SECOND)
    executor.run(lambda: executor.now() >= until or bool(ends))
    if ends:
        raise RuntimeError(f"the simulation ended: {ends[0]}")
    return 1000.0 * (time.process_time() - began) / seconds


def measure() -> list[Metric]:
    """Measure rays in the hall, and the whole simulation in three worlds."""
    limits = {"room": 12.0, "office": 12.0, "hall": 16.0}
    return rays() + [
        Metric(f"{world}: the simulation, CPU per simulated second",
               min(simulated(f"{world}.yaml", 20.0) for _ in range(3)), "ms", at_most=limit)
        for world, limit in limits.items()
    ]  # fmt: skip


def _ignore(problem: str) -> None:
    """Ignore error reports."""
