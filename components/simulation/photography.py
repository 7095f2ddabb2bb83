"""A photograph of a scene: its ideal image, through lens and exposure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from components.simulation.atlas import Atlas
from components.simulation.camera_config import LightConfig, SensorConfig
from components.simulation.exposure import Film, Noise, blurred
from components.simulation.lens import Distortion
from components.simulation.surfaces import Surfaces
from components.simulation.view import Station, ideal_image

Grey = NDArray[np.uint8]

# An exposure of this length with gain 1 gives grey levels as surfaces have them [s].
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
) -> Grey:
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
