"""Which objects a camera would recognize, by geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cairn.components.simulation.rays import cast
from cairn.components.simulation.scanning import Surroundings
from cairn.planar.poses import Pose, compose, wrap

# What lies this near before an object's middle does not hide it: what it hangs on [m].
BEHIND_M = 0.1


@dataclass(frozen=True)
class Eye:
    """A camera and its recognizer: field of view [rad], range [m], facing [rad], chances [1].

    Deviations: `range_sd` [m] + `range_sd_m2` [1/m] times the range squared; `bearing_sd` [rad].
    """

    field_of_view: float
    nearest: float
    farthest: float
    facing: float
    range_sd: float
    range_sd_m2: float
    bearing_sd: float
    detected: float
    mistaken: float


@dataclass(frozen=True)
class Thing:
    """A visible object: its number and pose, heading where it faces."""

    object_id: int
    pose: Pose


@dataclass(frozen=True)
class Recognized:
    """An object as the recognizer tells it: range [m], bearing [rad], their deviations."""

    object_id: int
    range_m: float
    bearing: float
    range_sd: float
    bearing_sd: float


def recognized(
    eye: Eye,
    robot: Pose,
    mount: Pose,
    things: Sequence[Thing],
    around: Surroundings,
    random: np.random.Generator,
) -> list[Recognized]:
    """What is recognized from a robot's pose, range and bearing from the robot's base."""
    camera = compose(robot, mount)
    opaque = around.without_glass
    found = []
    for thing in things:
        # Drawn for each thing, seen or not: what one does changes nothing for the others.
        chance, confusion = random.random(2)
        noise = random.standard_normal(2)
        if chance >= eye.detected or not _visible(eye, camera, thing, opaque):
            continue
        x, y, _ = thing.pose
        dx, dy = x - robot[0], y - robot[1]
        distance = math.hypot(dx, dy)
        range_sd = eye.range_sd + eye.range_sd_m2 * distance**2
        object_id = thing.object_id
        if confusion < eye.mistaken and len(things) > 1:
            others = [other.object_id for other in things if other.object_id != object_id]
            object_id = others[int(confusion / eye.mistaken * len(others))]
        found.append(
            Recognized(
                object_id,
                max(0.05, distance + range_sd * float(noise[0])),
                wrap(math.atan2(dy, dx) - robot[2] + eye.bearing_sd * float(noise[1])),
                range_sd,
                eye.bearing_sd,
            )
        )
    return found


def _visible(eye: Eye, camera: Pose, thing: Thing, opaque: Surroundings) -> bool:
    dx, dy = thing.pose[0] - camera[0], thing.pose[1] - camera[1]
    distance = math.hypot(dx, dy)
    if not eye.nearest <= distance <= eye.farthest:
        return False
    direction = math.atan2(dy, dx)
    if abs(wrap(direction - camera[2])) > eye.field_of_view / 2:
        return False
    if abs(wrap(direction + math.pi - thing.pose[2])) > eye.facing:
        return False
    start = np.array([[camera[0], camera[1]]])
    reach = distance - BEHIND_M
    ranges, _ = cast(start, np.array([direction]), opaque.segments, opaque.people, reach)
    return bool(math.isinf(ranges[0]))
