"""The driver of a simulated object recognizer: what a camera would recognize, by geometry."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from cairn import LATCHED, RELIABLE, Component, Config, In, Mount, Out, every, from_ns, on
from cairn.components.simulation.recognition import Eye, recognized
from cairn.components.simulation.watching import WorldWatch
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.cairn_sim_msgs import Scene, WorldState
from cairn.schemas.std_msgs import Header


class SimulatedRecognizerConfig(Config):
    """A camera and its recognizer; all may be changed while it runs."""

    field_of_view: float = Field(
        math.radians(60), gt=0, le=2 * math.pi, description="Horizontal field of view [rad]."
    )
    nearest: float = Field(0.4, ge=0, le=100, description="Nearest object [m].")
    farthest: float = Field(5.0, gt=0, le=100, description="Farthest object [m].")
    facing: float = Field(
        math.radians(70), gt=0, le=math.pi, description="How aslant an object is recognized [rad]."
    )
    range_sd: float = Field(0.01, ge=0, le=1, description="Deviation of the range [m].")
    range_sd_m2: float = Field(
        0.01, ge=0, le=1, description="Deviation that grows with the range squared [1/m]."
    )
    bearing_sd: float = Field(
        math.radians(1), gt=0, le=1, description="Deviation of the bearing [rad]."
    )
    detected: float = Field(
        0.7, ge=0, le=1, description="Chance that an object in view is recognized [1]."
    )
    mistaken: float = Field(
        0.01, ge=0, le=1, description="Chance that it is taken for another one [1]."
    )
    mount: Mount = Field(Mount(), description="Where the camera sits on the robot.")


class SimulatedRecognizer(Component):
    """Recognizes the objects of the simulated world five times a second."""

    config: SimulatedRecognizerConfig

    world_state: In[WorldState] = In(qos=RELIABLE.with_depth(200))
    scene: In[Scene] = In(qos=LATCHED)
    objects: Out[RecognizedObjectArray] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Nothing was seen yet."""
        self._watch = WorldWatch()

    def on_parameters(self, new: Config) -> None:
        """Any change that the model allows is taken."""

    @on("scene")
    def know(self, scene: Scene) -> None:
        """Take what stands."""
        self._watch.take_scene(scene)

    @on("world_state")
    def watch(self, state: WorldState) -> None:
        """Take what moves."""
        self._watch.take_state(state)

    @every(hz=5)
    def look(self) -> None:
        """Tell what is recognized now, be it nothing."""
        now = self.clock.now()
        poses = self._watch.robot_at(now, np.zeros(1))
        if poses is None:
            return
        x, y, theta = poses[0].tolist()
        config = self.config
        eye = Eye(
            config.field_of_view,
            config.nearest,
            config.farthest,
            config.facing,
            config.range_sd,
            config.range_sd_m2,
            config.bearing_sd,
            config.detected,
            config.mistaken,
        )
        watch = self._watch
        found = recognized(
            eye, (x, y, theta), config.mount.pose, watch.things, watch.around, self.random
        )
        middle, half = config.mount.theta, config.field_of_view / 2
        self.objects.publish(
            RecognizedObjectArray(
                header=Header(stamp=from_ns(now), frame_id="base_link"),
                view_right=middle - half,
                view_left=middle + half,
                nearest=min(config.nearest, config.farthest),
                farthest=config.farthest,
                objects=tuple(
                    RecognizedObject(
                        object_id=one.object_id,
                        range=one.range_m,
                        bearing=one.bearing,
                        covariance=np.array([one.range_sd**2, 0.0, 0.0, one.bearing_sd**2]),
                    )
                    for one in found
                ),
            )
        )
