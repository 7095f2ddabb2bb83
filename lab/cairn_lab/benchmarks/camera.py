"""Processor time of a pair of images of the simulated stereo camera."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np

from cairn.components.simulation.camera import LightConfig, SensorConfig, photograph
from cairn.components.simulation.camera_optics import ImageSensor, LensDistortion, PinholeCamera
from cairn.components.simulation.layout import WorldLayout, geometry_message
from cairn.components.simulation.people import Walker, circles_of
from cairn.components.simulation.rendering import CameraPose, surfaces_of
from cairn.components.simulation.world_file import read_world
from cairn.schemas.std_msgs import Header
from cairn_lab.benchmarks.result import Metric

_WORLDS = Path(__file__).parents[3] / "deploy" / "worlds"
_BASELINE_M, _HEIGHT_M = 0.09, 1.0
_POSES = 24


def pair_ms(world: str, distortion: tuple[float, ...] = ()) -> float:
    """Return the median processor time [ms] of a pair of images, from random poses in a world."""
    found = read_world(_WORLDS / f"{world}.yaml")
    layout = WorldLayout.of(found)
    surfaces, atlas = surfaces_of(geometry_message(Header(), layout))
    surfaces = surfaces.with_people(circles_of([Walker.of(one) for one in found.people]))
    lens = LensDistortion(PinholeCamera.of(640, 480, math.radians(60)), distortion)
    random = np.random.default_rng(0)
    film = ImageSensor(640, 480, random)
    ends = layout.solid_segments.segments.reshape(-1, 2)
    times: list[float] = []
    while len(times) < _POSES:
        x, y = random.uniform(ends.min(axis=0), ends.max(axis=0)).tolist()
        if layout.outside(x, y, 0.3):
            continue
        left = CameraPose((x, y, float(random.uniform(-math.pi, math.pi))), _HEIGHT_M)
        began = time.thread_time()
        for camera_pose in (left, left.beside(_BASELINE_M)):
            photograph(surfaces, atlas, camera_pose, lens, film, LightConfig(), SensorConfig())
        times.append(time.thread_time() - began)
    return 1e3 * float(np.median(times))


def measure() -> list[Metric]:
    """Return all metrics."""
    metrics = []
    for world in ("room", "office", "hall"):
        ms = pair_ms(world)
        metrics.append(
            Metric(f"pair of 640 x 480 images, {world}.yaml", ms, "ms", at_most=12.0,
                   note=f"{1e3 / ms:.0f} pairs a second")
        )  # fmt: skip
    ms = pair_ms("room", (-0.28, 0.08))
    metrics.append(
        Metric("the same of room.yaml, through lenses with distortion", ms, "ms",
               note=f"{1e3 / ms:.0f} pairs a second")
    )  # fmt: skip
    return metrics
