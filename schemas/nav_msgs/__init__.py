"""ROS 2 package nav_msgs: odometry, maps and paths."""

from typing import Annotated, Any, Final

import numpy as np

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.field_types import Int8Array, Scalar, String, UInt32, empty
from cairn.schemas.geometry_msgs import Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance
from cairn.schemas.message import message, reject
from cairn.schemas.std_msgs import Header

MOST_CELLS: Final = 25_000_000
"""Most cells of a grid map: 250 m x 250 m at 5 cm."""

SMALLEST_CELL: Final = 1e-3
"""Finest resolution of a grid map [m]; a laser scanner measures to about 1 cm."""

LARGEST_ORIGIN: Final = 1e7
"""Largest coordinate of a grid map's origin [m]: those of UTM reach 1e7."""


@message("nav_msgs/msg/Odometry")
class Odometry:
    """A pose in frame `header.frame_id` and a velocity in frame `child_frame_id`."""

    header: Header = Header()
    child_frame_id: String = ""
    pose: PoseWithCovariance = PoseWithCovariance()
    twist: TwistWithCovariance = TwistWithCovariance()


@message("nav_msgs/msg/MapMetaData")
class MapMetaData:
    """Size [cells], resolution [m/cell] and the pose of the corner of cell (0, 0)."""

    map_load_time: Time = Time()
    resolution: Annotated[float, Scalar("float32", at_least=0)] = 0.0
    width: UInt32 = 0
    height: UInt32 = 0
    origin: Pose = Pose()


def _repair_grid(values: dict[str, Any]) -> list[str]:
    """Repair a map with values that the format does not have."""
    cells = values["data"]
    values["data"] = np.where(cells < -1, -1, np.minimum(cells, 100)).astype(np.int8)
    return ["cells below -1 are unknown, those above 100 occupied"]


@message("nav_msgs/msg/OccupancyGrid", repair=_repair_grid)
class OccupancyGrid:
    """A map of cells, row by row from (0, 0): 0 (free) to 100 (occupied), -1 unknown."""

    header: Header = Header()
    info: MapMetaData = MapMetaData()
    data: Int8Array = empty(np.int8)

    def __post_init__(self) -> None:
        """Check that there are width * height cells with valid values."""
        cells = self.info.width * self.info.height
        if cells > MOST_CELLS:
            reject(self, "info.width", self.info.width, f"makes {cells} cells, above {MOST_CELLS}")
        if self.data.size != cells:
            reject(self, "data", self.data, f"must have width * height = {cells} cells")
        if cells and not (self.data.min() >= -1 and self.data.max() <= 100):
            reject(self, "data", self.data, "must hold values from -1 to 100")
        if cells and self.info.resolution < SMALLEST_CELL:
            reject(
                self,
                "info.resolution",
                self.info.resolution,
                f"must be at least {SMALLEST_CELL} where there are cells",
            )
        corner = self.info.origin.position
        if max(abs(corner.x), abs(corner.y)) > LARGEST_ORIGIN:
            reject(self, "info.origin", corner, f"must be at most {LARGEST_ORIGIN:g} from 0")


@message("nav_msgs/msg/Path")
class Path:
    """Poses to follow, in order."""

    header: Header = Header()
    poses: tuple[PoseStamped, ...] = ()
