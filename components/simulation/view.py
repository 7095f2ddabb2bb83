"""What a level camera sees of a scene: the image of an ideal lens, and where things are in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.atlas import Atlas
from cairn.components.simulation.columns import paint, project
from cairn.components.simulation.lens import Lens
from cairn.components.simulation.surfaces import Surfaces, panel_ends
from cairn.planar.poses import Pose

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Station:
    """Where a camera is: its pose on the floor [m, rad] and its height above it [m]."""

    pose: Pose
    height: float

    def beside(self, right: float) -> Station:
        """So far to the right [m], looking the same way."""
        x, y, theta = self.pose
        place = (x + right * math.sin(theta), y - right * math.cos(theta), theta)
        return Station(place, self.height)


def ideal_image(
    surfaces: Surfaces, atlas: Atlas, station: Station, lens: Lens, spread: float = 0.0
) -> Float32:
    """The image (h, w) in gray levels as they are in full light.

    It varies from place to place by `spread` [1] of it.
    """
    x, y, theta = station.pose
    camera = np.array([x, y, station.height, math.cos(theta), math.sin(theta)])
    glass = np.array([lens.focal, lens.focal, lens.cx, lens.cy])
    seen, which, borders = project(surfaces.ends, camera, glass, lens.width)
    image = np.empty((lens.width, lens.height), np.float32)
    paint(
        seen, which, borders, surfaces.extents, surfaces.scales, surfaces.brightness,
        surfaces.kinds, atlas.sums, atlas.begins, atlas.shapes, atlas.levels, atlas.level_begins,
        camera, glass, surfaces.ceiling, spread, image,
    )  # fmt: skip
    return np.asarray(cv2.transpose(image), np.float32)


def panel_corners(
    pose: Pose, size: tuple[float, float], z: float, station: Station, lens: Lens
) -> Array:
    """Where the corners of a picture are in the image: (4, 2) [px].

    From the top left one clockwise, as one who faces it sees them. The picture hangs at `pose`, its
    middle `z` [m] above the floor. NaN for a corner that is not before the camera.
    """
    left_x, left_y, right_x, right_y = panel_ends(np.array([pose]), np.array([size[0]]))[0]
    top, bottom = z + 0.5 * size[1], z - 0.5 * size[1]
    corners = np.array(
        [
            (left_x, left_y, top),
            (right_x, right_y, top),
            (right_x, right_y, bottom),
            (left_x, left_y, bottom),
        ]
    )
    x, y, theta = station.pose
    cosine, sine = math.cos(theta), math.sin(theta)
    dx, dy = corners[:, 0] - x, corners[:, 1] - y
    depth = cosine * dx + sine * dy
    depth = np.where(depth > 0, depth, np.nan)
    across, down = sine * dx - cosine * dy, station.height - corners[:, 2]
    return np.column_stack(
        (lens.cx + lens.focal * across / depth, lens.cy + lens.focal * down / depth)
    )
