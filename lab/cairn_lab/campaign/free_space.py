"""Random poses in the free space of the robot's map."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from cairn.client.robot import Robot
from cairn.errors import CairnError
from cairn.schemas.message import InvalidMessage
from cairn.schemas.nav_msgs import OccupancyGrid

_MAP_LIMIT_S = 5.0


class FreeSpace:
    """The cells of a grid map that are free, with a distance to all others."""

    def __init__(self, grid: OccupancyGrid, clearance: float) -> None:
        """Keep the cells that are at least `clearance` [m] away from all that are not free.

        Raises `CairnError` if there is none.
        """
        info = grid.info
        shape = (info.height, info.width)
        is_free = np.asarray(grid.data).reshape(shape) == 0
        # Beyond the map nothing is known.
        distances: npt.NDArray[np.float64] = distance_transform_edt(np.pad(is_free, 1))[1:-1, 1:-1]
        rows, columns = np.nonzero(distances * info.resolution >= clearance)
        if not rows.size:
            raise CairnError(f"the map has no free place {clearance:g} m from all obstacles")
        origin = info.origin.position
        self._places = np.column_stack(
            (
                origin.x + (columns + 0.5) * info.resolution,
                origin.y + (rows + 0.5) * info.resolution,
            )
        )

    def pose(self, random: Random) -> tuple[float, float, float]:
        """Return a random pose x, y [m], heading [rad]."""
        x, y = self._places[int(random.random() * len(self._places))]
        return round(float(x), 2), round(float(y), 2), round(random.uniform(-math.pi, math.pi), 2)


def free_space(robot: Robot, clearance: float) -> FreeSpace:
    """Return the free space of the map that a robot publishes; `CairnError` without a map."""
    try:
        grid = robot.latest("map", OccupancyGrid, timeout_s=_MAP_LIMIT_S)
    except InvalidMessage as error:  # published by a fault
        raise CairnError(str(error)) from error
    return FreeSpace(grid, clearance)
