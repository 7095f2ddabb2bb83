"""Scenes for tests of the simulated camera, and what it sees of them."""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.atlas import Atlas
from cairn.components.simulation.lens import Lens
from cairn.components.simulation.messages import scene_message
from cairn.components.simulation.scene import Scene
from cairn.components.simulation.surfaces import Surfaces, surfaces_of
from cairn.components.simulation.view import Station, ideal_image, panel_corners
from cairn.components.simulation.world_file import VisibleObject
from cairn.planar.poses import Pose
from cairn.schemas.std_msgs import Header
from tests.components.simulation.worlds import world_file

LENS = Lens.of(640, 480, math.radians(60))
# Hangs on the wall x = 6 of the box, and faces the origin's side.
POSTER = {"id": 7, "x": 6.0, "y": 2.0, "theta": math.pi, "width": 0.5, "height": 0.4}


def stands(**more: Any) -> tuple[Surfaces, Atlas]:
    """What a camera sees of the room of 6 m x 4 m with `more` in it."""
    return surfaces_of(scene_message(Header(), Scene.of(world_file(**more))))


def seen(
    pose: Pose, height: float = 1.0, right: float = 0.0, lens: Lens = LENS, **more: Any
) -> NDArray[np.float32]:
    """The image from there, in even light."""
    return ideal_image(*stands(**more), Station(pose, height).beside(right), lens)


def corners(
    thing: dict[str, Any], pose: Pose, height: float = 1.0, right: float = 0.0, lens: Lens = LENS
) -> NDArray[np.float64]:
    """Where the corners of an object's picture are in that image [px]."""
    model = VisibleObject.model_validate(thing)
    station = Station(pose, height).beside(right)
    return panel_corners(model.pose, model.size, model.z, station, lens)


def cut_out(
    image: NDArray[Any], around: NDArray[np.float64], width: int, height: int
) -> NDArray[np.float32]:
    """What is between four corners, straightened to that size."""
    w, h = width - 0.5, height - 0.5
    flat = np.array([(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)], np.float32)
    warp = cv2.getPerspectiveTransform(around.astype(np.float32), flat)
    return np.asarray(cv2.warpPerspective(image, warp, (width, height)), np.float32)
