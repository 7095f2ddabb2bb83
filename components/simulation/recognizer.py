"""The driver of a simulated object recognizer: visibility by geometry, and the component."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from cairn import LATCHED, RELIABLE, Component, Config, In, Mount, Out, every, from_ns, on
from cairn.components.simulation.layout import BEHIND_M
from cairn.components.simulation.ray_casting import cast
from cairn.components.simulation.world_tracker import RayTargets, RecognizableObject, WorldTracker
from cairn.planar.poses import Pose, compose, wrap
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.cairn_sim_msgs import WorldGeometry, WorldState
from cairn.schemas.std_msgs import Header


@dataclass(frozen=True)
class RecognizerModel:
    """A camera and its recognizer: field of view, range, oblique angle [rad, m], chances.

    Standard deviations: `range_sd` [m] + `range_sd_m2` [1/m] times the squared range; `bearing_sd`
    [rad].
    """

    field_of_view: float
    nearest: float
    farthest: float
    facing: float
    range_sd: float
    range_sd_m2: float
    bearing_sd: float
    detection_probability: float
    confusion_probability: float


@dataclass(frozen=True)
class SimulatedRecognition:
    """An observation of an object: range [m], bearing [rad], and their standard deviations."""

    object_id: int
    range_m: float
    bearing: float
    range_sd: float
    bearing_sd: float


def recognize(
    model: RecognizerModel,
    robot: Pose,
    mount: Pose,
    objects: Sequence[RecognizableObject],
    targets: RayTargets,
    random: np.random.Generator,
) -> list[SimulatedRecognition]:
    """Return the recognized objects, range and bearing relative to the robot's base."""
    camera = compose(robot, mount)
    opaque = targets.without_glass
    observations = []
    for item in objects:
        # Drawn for each object, visible or not: so objects do not change each other's random
        # numbers.
        chance, confusion = random.random(2)
        noise = random.standard_normal(2)
        if chance >= model.detection_probability or not _is_visible(model, camera, item, opaque):
            continue
        x, y, _ = item.pose
        dx, dy = x - robot[0], y - robot[1]
        distance = math.hypot(dx, dy)
        range_sd = model.range_sd + model.range_sd_m2 * distance**2
        object_id = item.object_id
        if confusion < model.confusion_probability and len(objects) > 1:
            others = [other.object_id for other in objects if other.object_id != object_id]
            object_id = others[int(confusion / model.confusion_probability * len(others))]
        observations.append(
            SimulatedRecognition(
                object_id,
                max(0.05, distance + range_sd * float(noise[0])),
                wrap(math.atan2(dy, dx) - robot[2] + model.bearing_sd * float(noise[1])),
                range_sd,
                model.bearing_sd,
            )
        )
    return observations


def _is_visible(
    model: RecognizerModel, camera: Pose, item: RecognizableObject, opaque: RayTargets
) -> bool:
    dx, dy = item.pose[0] - camera[0], item.pose[1] - camera[1]
    distance = math.hypot(dx, dy)
    if not model.nearest <= distance <= model.farthest:
        return False
    direction = math.atan2(dy, dx)
    if abs(wrap(direction - camera[2])) > model.field_of_view / 2:
        return False
    if abs(wrap(direction + math.pi - item.pose[2])) > model.facing:
        return False
    start = np.array([[camera[0], camera[1]]])
    reach = distance - BEHIND_M
    ranges, _ = cast(start, np.array([direction]), opaque.segments, opaque.people, reach)
    return bool(math.isinf(ranges[0]))


class SimulatedRecognizerConfig(Config):
    """A camera and its recognizer; all parameters may change at run time."""

    field_of_view: float = Field(
        math.radians(60), gt=0, le=2 * math.pi, description="Horizontal field of view [rad]."
    )
    nearest: float = Field(0.4, ge=0, le=100, description="Minimum distance of an object [m].")
    farthest: float = Field(5.0, gt=0, le=100, description="Largest distance of an object [m].")
    facing: float = Field(
        math.radians(70),
        gt=0,
        le=math.pi,
        description="Largest angle between the view and the object's normal [rad].",
    )
    range_sd: float = Field(0.01, ge=0, le=1, description="Standard deviation of the range [m].")
    range_sd_m2: float = Field(
        0.01, ge=0, le=1, description="Standard deviation of the range per squared range [1/m]."
    )
    bearing_sd: float = Field(
        math.radians(1), gt=0, le=1, description="Standard deviation of the bearing [rad]."
    )
    detection_probability: float = Field(
        0.7, ge=0, le=1, description="Probability that a visible object is recognized [1]."
    )
    confusion_probability: float = Field(
        0.01,
        ge=0,
        le=1,
        description="Probability that a recognized object is reported as another one [1].",
    )
    mount: Mount = Field(Mount(), description="Pose of the camera on the robot.")


class SimulatedRecognizer(Component):
    """Recognize the objects of the simulated world by geometry, five times per second.

    Simulated are field of view, occlusion, misses and false matches.
    """

    config: SimulatedRecognizerConfig

    world_state: In[WorldState] = In(qos=RELIABLE.with_depth(200))
    world_geometry: In[WorldGeometry] = In(qos=LATCHED)
    objects: Out[RecognizedObjectArray] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Start without knowledge of the world."""
        self._world = WorldTracker(self.robot)

    def on_parameters(self, new: Config) -> None:
        """Accept all valid changes."""

    @on("world_geometry")
    def on_world_geometry(self, geometry: WorldGeometry) -> None:
        """Take walls, furniture and objects."""
        self._world.update_geometry(geometry)

    @on("world_state")
    def on_world_state(self, state: WorldState) -> None:
        """Take the poses of robot and people."""
        self._world.update_state(state)

    @every(hz=5)
    def recognize_objects(self) -> None:
        """Publish the objects that are recognized now; an empty list if nothing is recognized."""
        now = self.clock.now()
        poses = self._world.robot_at(now, np.zeros(1))
        if poses is None:
            return
        x, y, theta = poses[0].tolist()
        config = self.config
        model = RecognizerModel(
            config.field_of_view,
            config.nearest,
            config.farthest,
            config.facing,
            config.range_sd,
            config.range_sd_m2,
            config.bearing_sd,
            config.detection_probability,
            config.confusion_probability,
        )
        on_world_state = self._world
        observations = recognize(
            model,
            (x, y, theta),
            config.mount.pose,
            on_world_state.objects,
            on_world_state.ray_targets,
            self.random,
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
                        object_id=item.object_id,
                        range=item.range_m,
                        bearing=item.bearing,
                        covariance=np.array([item.range_sd**2, 0.0, 0.0, item.bearing_sd**2]),
                    )
                    for item in observations
                ),
            )
        )
