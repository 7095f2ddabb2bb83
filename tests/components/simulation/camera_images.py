"""Small worlds for tests of the simulated camera, and its images of them."""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.camera_optics import PinholeCamera
from cairn.components.simulation.layout import WorldLayout, geometry_message
from cairn.components.simulation.rendering import (
    CameraPose,
    VisibleSurfaces,
    ideal_image,
    panel_ends,
    surfaces_of,
)
from cairn.components.simulation.textures import TextureAtlas
from cairn.components.simulation.world_file import VisibleObject
from cairn.planar.poses import Pose
from cairn.schemas.std_msgs import Header
from tests.components.simulation.worlds import world_file

LENS = PinholeCamera.of(640, 480, math.radians(60))
# It hangs on the wall x = 6 of the box and faces the origin's side.
POSTER = {"id": 7, "x": 6.0, "y": 2.0, "theta": math.pi, "width": 0.5, "height": 0.4}


def surfaces_with(**more: Any) -> tuple[VisibleSurfaces, TextureAtlas]:
    """The surfaces of the room of 6 m x 4 m with `more` in it."""
    return surfaces_of(geometry_message(Header(), WorldLayout.of(world_file(**more))))


def image_from(
    pose: Pose, height: float = 1.0, right: float = 0.0, lens: PinholeCamera = LENS, **more: Any
) -> NDArray[np.float32]:
    """The image from a pose, in even light."""
    return ideal_image(*surfaces_with(**more), CameraPose(pose, height).beside(right), lens)


def corners(
    visible_object: dict[str, Any],
    pose: Pose,
    height: float = 1.0,
    right: float = 0.0,
    lens: PinholeCamera = LENS,
) -> NDArray[np.float64]:
    """The corners of an object's picture in that image [px]."""
    model = VisibleObject.model_validate(visible_object)
    camera_pose = CameraPose(pose, height).beside(right)
    return panel_corners(model.pose, model.size, model.z, camera_pose, lens)


def panel_corners(
    pose: Pose, size: tuple[float, float], z: float, camera_pose: CameraPose, lens: PinholeCamera
) -> NDArray[np.float64]:
    """Return the corners of a picture in the image: (4, 2) [px].

    Clockwise from the top left one, as seen from the front. The picture hangs at `pose`, its center
    `z` [m] above the floor. NaN for a corner that is not in front of the camera.
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
    x, y, theta = camera_pose.pose
    cosine, sine = math.cos(theta), math.sin(theta)
    dx, dy = corners[:, 0] - x, corners[:, 1] - y
    depth = cosine * dx + sine * dy
    depth = np.where(depth > 0, depth, np.nan)
    across, down = sine * dx - cosine * dy, camera_pose.height - corners[:, 2]
    return np.column_stack(
        (lens.cx + lens.focal * across / depth, lens.cy + lens.focal * down / depth)
    )


def cut_out(
    image: NDArray[Any], around: NDArray[np.float64], width: int, height: int
) -> NDArray[np.float32]:
    """The area between four corners, rectified to that size."""
    w, h = width - 0.5, height - 0.5
    flat = np.array([(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)], np.float32)
    warp = cv2.getPerspectiveTransform(around.astype(np.float32), flat)
    return np.asarray(cv2.warpPerspective(image, warp, (width, height)), np.float32)
