"""The driver of the simulated range scanner: scanner models, beam simulation, the component."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cairn import (
    SECOND,
    SENSOR,
    CairnError,
    Config,
    FromRobot,
    Mount,
    Out,
    from_ns,
)
from cairn.components.simulation.layout import SURFACES
from cairn.components.simulation.ray_casting import cast
from cairn.components.simulation.sensor import WorldSensor
from cairn.components.simulation.world_tracker import RayTargets, sensor_poses
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header


@dataclass(frozen=True)
class ScannerModel:
    """The data sheet values of a scanner.

    Field of view `first` to `last` [rad] in `steps` beams; `turn_s` [s] is one turn of the mirror;
    `least` and `most` [m] limit the range. The standard deviation is `noise_m` [m], or the share
    `noise_share` [1] of the range if that is more.
    """

    first: float
    last: float
    steps: int
    turn_s: float
    least: float
    most: float
    noise_m: float
    noise_share: float

    @property
    def increment(self) -> float:
        """Return the angle between two beams [rad]."""
        return (self.last - self.first) / (self.steps - 1)

    @property
    def time_increment(self) -> float:
        """Return the time between two beams [s]."""
        return self.turn_s * self.increment / (2.0 * math.pi)


def _model(
    turn_steps: int,
    steps: int,
    rate: float,
    least: float,
    most: float,
    noise: tuple[float, float],
) -> ScannerModel:
    """Return a model whose full turn has `turn_steps`, of which the middle `steps` are measured."""
    half = math.pi * (steps - 1) / turn_steps
    return ScannerModel(-half, half, steps, 1.0 / rate, least, most, *noise)


MODELS: dict[str, ScannerModel] = {
    # Steps as the devices report them (ARES, AMIN, AMAX). Standard deviations are half of the
    # accuracy in the data sheets, except for the UST: its +-40 mm hold for any surface, so it gets
    # the deviation of the UTM.
    "URG-04LX": _model(1024, 682, 10.0, 0.06, 4.095, (0.005, 0.005)),
    "URG-04LX-UG01": _model(1024, 682, 10.0, 0.06, 5.6, (0.015, 0.015)),
    "UTM-30LX": _model(1440, 1081, 40.0, 0.1, 30.0, (0.015, 0.0)),
    "UST-10LX": _model(1440, 1081, 40.0, 0.06, 10.0, (0.015, 0.0)),
    "UST-20LX": _model(1440, 1081, 40.0, 0.06, 20.0, (0.015, 0.0)),
    # An LED scanner for obstacles: coarse, short-ranged, and far less accurate.
    "PBS-03JN": _model(200, 121, 10.0, 0.2, 3.0, (0.05, 0.05)),
}


Array = NDArray[np.float64]


@dataclass(frozen=True)
class BeamPattern:
    """The beams of a model that are measured: every `skip`-th between two angles [rad]."""

    angles: Array
    times: Array

    @staticmethod
    def of(model: ScannerModel, first: float, last: float, skip: int) -> BeamPattern:
        """Return the beams between `first` and `last` [rad]; times [s] start at the first one."""
        angles: Array = model.first + model.increment * np.arange(model.steps, dtype=np.float64)
        inside = np.nonzero((angles >= first - 1e-9) & (angles <= last + 1e-9))[0][::skip]
        times = (inside - inside[0]) * model.time_increment if len(inside) else np.zeros(0)
        return BeamPattern(angles[inside], times)


def simulate_sweep(
    model: ScannerModel,
    beams: BeamPattern,
    faults: SimulatedScannerConfig,
    poses: Array,
    targets: RayTargets,
    random: np.random.Generator,
) -> NDArray[np.float32]:
    """Return ranges (n,) [m] of beams sent from `poses` (n, 3) [m, rad] of the scanner.

    Infinite where nothing was hit, NaN where the beam failed. Of `faults`, only the shares count.
    """
    count = beams.angles.size
    starts = np.ascontiguousarray(poses[:, :2])
    angles = poses[:, 2] + beams.angles
    ranges, hit = cast(starts, angles, targets.segments, targets.people, model.most)
    surfaces = _surfaces(hit, targets.surfaces)
    _pass_through_glass(ranges, surfaces, starts, angles, model.most, faults, targets, random)
    dark = surfaces == SURFACES["dark"]
    ranges[dark & (ranges > faults.dark_reach * model.most)] = math.inf
    was_hit = np.isfinite(ranges)
    deviation = np.maximum(model.noise_m, model.noise_share * np.where(was_hit, ranges, 0.0))
    ranges += deviation * random.standard_normal(count)
    ranges[was_hit & (ranges < model.least)] = math.nan
    ranges[ranges >= model.most] = math.inf
    chance = random.random(count)
    ranges[chance < np.where(dark, faults.dark_dropouts, faults.dropouts)] = math.nan
    return ranges.astype(np.float32)


def _surfaces(hit: NDArray[np.int64], solid: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the surface that each ray hit; people and nothing count as plain."""
    surfaces = np.full(hit.size, SURFACES["plain"], np.uint8)
    was_hit = (hit >= 0) & (hit < solid.size)
    surfaces[was_hit] = solid[hit[was_hit]]
    return surfaces


def _pass_through_glass(
    ranges: Array,
    surfaces: NDArray[np.uint8],
    starts: Array,
    angles: Array,
    reach: float,
    faults: SimulatedScannerConfig,
    targets: RayTargets,
    random: np.random.Generator,
) -> None:
    """Let most rays that hit glass continue to what is behind it."""
    through = np.nonzero(surfaces == SURFACES["glass"])[0]
    through = through[random.random(through.size) >= faults.glass_returns]
    if through.size:
        solid = targets.without_glass
        ranges[through], behind = cast(
            starts[through], angles[through], solid.segments, solid.people, reach
        )
        surfaces[through] = _surfaces(behind, solid.surfaces)


_FRAME = "laser"

ModelName = Literal["URG-04LX", "URG-04LX-UG01", "UTM-30LX", "UST-10LX", "UST-20LX", "PBS-03JN"]


class SimulatedScannerConfig(Config):
    """The scanner's model and settings."""

    model: ModelName = Field("UST-10LX", description="Scanner model.")
    rate: float | None = Field(
        None, gt=0, le=100, description="Scans per second [1/s]; none: as fast as the model turns."
    )
    first: float = Field(
        -math.pi, ge=-math.pi, le=math.pi, description="Least angle of the first beam [rad]."
    )
    last: float = Field(
        math.pi, ge=-math.pi, le=math.pi, description="Largest angle of the last beam [rad]."
    )
    skip: int = Field(1, ge=1, le=100, description="Measure every `skip`-th beam [1].")
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Field(
        Mount(), description="Pose of the scanner on the robot."
    )
    farthest: float | None = Field(
        None, gt=0, le=100, description="Largest range, if less than the model's [m]."
    )
    dropouts: float = Field(0.002, ge=0, le=1, description="Share of beams that fail [1].")
    dark_dropouts: float = Field(
        0.3, ge=0, le=1, description="Share of beams that fail at dark surfaces [1]."
    )
    dark_reach: float = Field(
        0.4, gt=0, le=1, description="Share of the range in which dark surfaces are measured [1]."
    )
    glass_returns: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Share of beams that glass reflects; the others pass through [1].",
    )


class SimulatedScanner(WorldSensor):
    """Measure the simulated world as a scanner of a real model does.

    Simulated are the motion during a scan, noise, failed beams, glass and dark surfaces. The
    models:

    - `URG-04LX`: 0.06 to 4.095 m, 239.4 degrees, 682 beams, 10 Hz, standard deviation 5 mm or 0.5
      %;
    - `URG-04LX-UG01`: 0.06 to 5.6 m, 239.4 degrees, 682 beams, 10 Hz, 15 mm or 1.5 %;
    - `UTM-30LX`: 0.1 to 30 m, 270 degrees, 1081 beams, 40 Hz, 15 mm;
    - `UST-10LX` and `UST-20LX`: 0.06 to 10 and 20 m, 270 degrees, 1081 beams, 40 Hz, 15 mm;
    - `PBS-03JN`: 0.2 to 3 m, 216 degrees, 121 beams, 10 Hz, 50 mm or 5 %.
    """

    # The beams are selected when the scanner is configured.
    live_parameters = frozenset()
    config: SimulatedScannerConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)

    def on_configure(self) -> None:
        """Select the beams; check range and rate."""
        super().on_configure()
        config = self.config
        model = MODELS[config.model]
        if config.farthest is not None:
            model = replace(model, most=min(model.most, config.farthest))
        if model.most <= model.least:
            raise CairnError(
                f"{self.name}: farthest = {model.most:g} is not above the least range "
                f"{model.least:g} m of a {config.model}; increase farthest"
            )
        self._model = model
        self._beams = BeamPattern.of(self._model, config.first, config.last, config.skip)
        if self._beams.angles.size < 2:
            raise CairnError(
                f"{self.name}: first = {config.first:g} rad and last = {config.last:g} rad leave "
                f"fewer than two beams of a {config.model}; widen the range"
            )
        self._period = (
            round(SECOND / config.rate) if config.rate else round(self._model.turn_s * SECOND)
        )
        if self._period < round(self._model.turn_s * SECOND):
            raise CairnError(
                f"{self.name}: rate = {config.rate:g} Hz, but a {config.model} turns "
                f"{1 / self._model.turn_s:g} times per second; lower the rate"
            )

    def on_activate(self) -> None:
        """Start to measure."""
        self.measure_every(self._period, self._sweep)

    def _sweep(self) -> None:
        beams, model = self._beams, self._model
        began = self.clock.now() - round(float(beams.times[-1]) * SECOND)
        robot = self.world.robot_at(began, beams.times)
        if robot is None:
            return
        scanner = sensor_poses(robot, self.config.mount.pose)
        targets = self.world.ray_targets
        ranges = simulate_sweep(model, beams, self.config, scanner, targets, self.random)
        skip = self.config.skip
        self.scan.publish(
            LaserScan(
                header=Header(stamp=from_ns(began), frame_id=_FRAME),
                angle_min=float(beams.angles[0]),
                angle_max=float(beams.angles[-1]),
                angle_increment=skip * model.increment,
                time_increment=skip * model.time_increment,
                scan_time=self._period / SECOND,
                range_min=model.least,
                range_max=model.most,
                ranges=ranges,
            )
        )
