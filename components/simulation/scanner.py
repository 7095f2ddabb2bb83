"""The driver of the simulated range scanner."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

from pydantic import Field

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    In,
    Mount,
    Out,
    ParameterRejected,
    from_ns,
    on,
)
from cairn.components.simulation.scanner_models import MODELS
from cairn.components.simulation.scanning import Beams, Faults, sweep
from cairn.components.simulation.watching import WorldWatch, composed
from cairn.planar.messages import transform_message
from cairn.schemas.cairn_sim_msgs import Scene, WorldState
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

_FRAME = "laser"

ModelName = Literal["URG-04LX", "URG-04LX-UG01", "UTM-30LX", "UST-10LX", "UST-20LX", "PBS-03JN"]


class SimulatedScannerConfig(Config):
    """Which scanner, and how it is used."""

    model: ModelName = Field("UST-10LX", description="Its model.")
    rate: float | None = Field(
        None, gt=0, le=100, description="Scans a second [1/s]; none: as the model turns."
    )
    first: float = Field(
        -math.pi, ge=-math.pi, le=math.pi, description="Angle of the first beam, at least [rad]."
    )
    last: float = Field(
        math.pi, ge=-math.pi, le=math.pi, description="Angle of the last beam, at most [rad]."
    )
    skip: int = Field(1, ge=1, le=100, description="Every how many beams one is measured [1].")
    mount: Mount = Field(Mount(), description="Where the scanner sits on the robot.")
    farthest: float | None = Field(
        None, gt=0, le=100, description="Range, where it is less than the model's [m]."
    )
    dropouts: float = Field(0.002, ge=0, le=1, description="Beams that fail [1].")
    dark_dropouts: float = Field(0.3, ge=0, le=1, description="Of those at dark surfaces [1].")
    dark_reach: float = Field(
        0.4, gt=0, le=1, description="Share of the range in which dark surfaces are seen [1]."
    )
    glass_returns: float = Field(
        0.1, ge=0, le=1, description="Beams that glass returns; others go through [1]."
    )


class SimulatedScanner(Component):
    """Sweeps the simulated world as a scanner of a real model would."""

    config: SimulatedScannerConfig

    world_state: In[WorldState] = In(qos=RELIABLE.with_depth(200))
    scene: In[Scene] = In(qos=LATCHED)
    scan: Out[LaserScan] = Out(qos=SENSOR)
    tf_static: Out[TFMessage] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Lay out the beams."""
        config = self.config
        model = MODELS[config.model]
        if config.farthest is not None:
            model = replace(model, most=min(model.most, config.farthest))
        if model.most <= model.least:
            raise CairnError(
                f"{self.name}: a {config.model} sees nothing nearer than {model.least:g} m; give "
                "farthest more than that"
            )
        self._model = model
        self._beams = Beams.of(self._model, config.first, config.last, config.skip)
        if self._beams.angles.size < 2:
            raise CairnError(
                f"{self.name}: first = {config.first:g} rad and last = {config.last:g} rad leave "
                f"no two beams of a {config.model}"
            )
        self._faults = Faults(
            config.dropouts, config.dark_dropouts, config.dark_reach, config.glass_returns
        )
        self._watch = WorldWatch()
        self._period = (
            round(SECOND / config.rate) if config.rate else round(self._model.turn_s * SECOND)
        )
        if self._period < round(self._model.turn_s * SECOND):
            raise CairnError(
                f"{self.name}: rate = {config.rate:g} Hz, but a {config.model} turns "
                f"{1 / self._model.turn_s:g} times a second"
            )

    def on_activate(self) -> None:
        """Tell where it sits on the robot; begin to turn."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id="base_link")
        mounted = transform_message(header, _FRAME, self.config.mount.pose)
        self.tf_static.publish(TFMessage(transforms=(mounted,)))
        self._due = self.clock.now() + self._period
        self.schedule(self._due, self._sweep)

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A scanner stays the one that it is."""
        raise ParameterRejected("the simulated scanner takes its parameters when it is configured")

    @on("scene")
    def know(self, scene: Scene) -> None:
        """Take what stands."""
        self._watch.take_scene(scene)

    @on("world_state")
    def watch(self, state: WorldState) -> None:
        """Take what moves."""
        self._watch.take_state(state)

    def _sweep(self) -> None:
        now = self.clock.now()
        self._due += self._period
        if self._due <= now:  # it was held up: sweeps that were missed are not made up for
            self._due = now + self._period
        self.schedule(self._due, self._sweep)
        beams, model = self._beams, self._model
        began = now - round(float(beams.times[-1]) * SECOND)
        robot = self._watch.robot_at(began, beams.times)
        if robot is None:
            return
        scanner = composed(robot, self.config.mount.pose)
        around = self._watch.around
        ranges = sweep(model, beams, self._faults, scanner, around, self.random)
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
