"""The driver of a simulated object recognizer: visibility by geometry, and the component."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from cairn import RELIABLE, Config, FromRobot, Mount, Out, every, from_ns
from cairn.components.simulation.layout import BEHIND_M
from cairn.components.simulation.ray_casting import cast
from cairn.components.simulation.sensor import WorldSensor
from cairn.components.simulation.world_tracker import RayTargets, RecognizableObject
from cairn.planar.poses import Pose, compose, wrap
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.std_msgs import Header


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
    mount: Annotated[Mount, FromRobot("mounts.camera")] = Field(
        Mount(), description="Pose of the camera on the robot."
    )


@dataclass(frozen=True)
class SimulatedRecognition:
    """An observation of an object: range [m], bearing [rad], and their standard deviations."""

    object_id: int
    range_m: float
    bearing: float
    range_sd: float
    bearing_sd: float


def recognize(
    config: SimulatedRecognizerConfig,
    robot: Pose,
    objects: Sequence[RecognizableObject],
    targets: RayTargets,
    random: np.random.Generator,
) -> list[SimulatedRecognition]:
    """Return the recognized objects, range and bearing relative to the robot's base."""
    camera = compose(robot, config.mount.pose)
    opaque = targets.without_glass
    observations = []
    for item in objects:
        # Drawn for each object, visible or not: so objects do not change each other's random
        # numbers.
        chance, confusion = random.random(2)
        noise = random.standard_normal(2)
        if chance >= config.detection_probability or not _is_visible(config, camera, item, opaque):
            continue
        x, y, _ = item.pose
        dx, dy = x - robot[0], y - robot[1]
        distance = math.hypot(dx, dy)
        range_sd = config.range_sd + config.range_sd_m2 * distance**2
        object_id = item.object_id
        if confusion < config.confusion_probability and len(objects) > 1:
            others = [other.object_id for other in objects if other.object_id != object_id]
            object_id = others[int(confusion / config.confusion_probability * len(others))]
        observations.append(
            SimulatedRecognition(
                object_id,
                max(0.05, distance + range_sd * float(noise[0])),
                wrap(math.atan2(dy, dx) - robot[2] + config.bearing_sd * float(noise[1])),
                range_sd,
                config.bearing_sd,
            )
        )
    return observations


def _is_visible(
    config: SimulatedRecognizerConfig, camera: Pose, item: RecognizableObject, opaque: RayTargets
) -> bool:
    dx, dy = item.pose[0] - camera[0], item.pose[1] - camera[1]
    distance = math.hypot(dx, dy)
    if not config.nearest <= distance <= config.farthest:
        return False
    direction = math.atan2(dy, dx)
    if abs(wrap(direction - camera[2])) > config.field_of_view / 2:
        return False
    if abs(wrap(direction + math.pi - item.pose[2])) > config.facing:
        return False
    start = np.array([[camera[0], camera[1]]])
    reach = distance - BEHIND_M
    ranges, _ = cast(start, np.array([direction]), opaque.segments, opaque.people, reach)
    return bool(math.isinf(ranges[0]))


class SimulatedRecognizer(WorldSensor):
    """Recognize the objects of the simulated world by geometry, five times per second.

    Simulated are field of view, occlusion, misses and false matches.
    """

    config: SimulatedRecognizerConfig

    objects: Out[RecognizedObjectArray] = Out(qos=RELIABLE.with_depth(200))

    def on_parameters(self, new: Config) -> None:
        """Accept all valid changes."""

    @every(hz=5)
    def recognize_objects(self) -> None:
        """Publish the objects that are recognized now; an empty list if nothing is recognized."""
        now = self.clock.now()
        poses = self.world.robot_at(now, np.zeros(1))
        if poses is None:
            return
        x, y, theta = poses[0].tolist()
        config, world = self.config, self.world
        observations = recognize(
            config, (x, y, theta), world.objects, world.ray_targets, self.random
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
