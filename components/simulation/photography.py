"""A photograph of a scene: its ideal image, through lens and exposure."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.components.simulation.atlas import Atlas
from cairn.components.simulation.camera_config import (
    LightConfig,
    SensorConfig,
    SimulatedStereoCameraConfig,
)
from cairn.components.simulation.exposure import Film, Noise, blurred
from cairn.components.simulation.lens import Distortion, Lens
from cairn.components.simulation.messages import scene_message
from cairn.components.simulation.people import Walker, circles_of
from cairn.components.simulation.scene import Scene
from cairn.components.simulation.surfaces import Surfaces, surfaces_of
from cairn.components.simulation.view import Station, ideal_image
from cairn.components.simulation.world_file import WorldFile
from cairn.planar.poses import Pose
from cairn.schemas.std_msgs import Header

Gray = NDArray[np.uint8]

# An exposure of this length with gain 1 gives gray levels as surfaces have them [s].
_REFERENCE_S = 0.004


def photograph(
    surfaces: Surfaces,
    atlas: Atlas,
    station: Station,
    lens: Distortion,
    film: Film,
    light: LightConfig,
    sensor: SensorConfig,
    drifted: float = 0.0,
    turn: float = 0.0,
) -> Gray:
    """The image (h, w), read-only.

    `drifted` is how far the light has drifted, in its deviations; `turn` [rad] how far the camera
    turns during the exposure, about `station`.
    """
    level = light.level * math.exp(light.drift * drifted)
    brightness = level * sensor.gain * sensor.exposure_s / _REFERENCE_S
    ideal = ideal_image(surfaces, atlas, station, lens.ideal, light.spread)
    image = blurred(lens.bent(ideal), sensor.defocus, lens.ideal.focal * abs(turn))
    noise = Noise(sensor.read_noise, sensor.shot_noise)
    return film.exposed(image, brightness, sensor.vignetting, noise)


def seen_from(world: WorldFile, pose: Pose, height: float, right: bool) -> Gray:
    """What a camera of the default kind sees of a world at its beginning, from `height` [m].

    Raises `CairnError` if that is not below the ceiling.
    """
    camera = SimulatedStereoCameraConfig()
    surfaces, atlas = surfaces_of(scene_message(Header(), Scene.of(world)))
    refuse_height(height, surfaces)
    people = circles_of([Walker.of(person) for person in world.people])
    return photograph(
        surfaces.with_people(people),
        atlas,
        Station(pose, height).beside(camera.baseline if right else 0.0),
        Distortion(Lens.of(camera.width, camera.height, camera.field_of_view), ()),
        Film(camera.width, camera.height, np.random.default_rng(0)),
        camera.light,
        camera.sensor,
    )


def refuse_height(height: float, surfaces: Surfaces) -> None:
    """`CairnError` if a camera so high [m] is not below the ceiling."""
    if height >= surfaces.ceiling:
        raise CairnError(
            f"the camera is {height:g} m high, which is not below the ceiling; that is as high as "
            f"the highest wall, {surfaces.ceiling:g} m: put the camera lower"
        )


def write_picture(picture: Gray, file: Path) -> None:
    """Write an image; `CairnError` if that cannot be."""
    try:
        written = cv2.imwrite(str(file), picture)
    except cv2.error as error:
        raise CairnError(f"{file}: pictures are written as .png or .jpg ({error.err})") from error
    if not written:
        raise CairnError(f"{file} cannot be written; is there such a folder, and may you write?")
