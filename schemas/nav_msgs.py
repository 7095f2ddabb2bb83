"""ROS 2 package nav_msgs: odometry, maps and paths."""

from typing import Annotated

import numpy as np

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.field_types import Int8Array, Scalar, String, UInt32, empty
from cairn.schemas.geometry_msgs import Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance
from cairn.schemas.message import message, reject
from cairn.schemas.std_msgs import Header


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


@message("nav_msgs/msg/OccupancyGrid")
class OccupancyGrid:
    """A map of cells, row by row from (0, 0): 0 (free) to 100 (occupied), -1 unknown."""

    header: Header = Header()
    info: MapMetaData = MapMetaData()
    data: Int8Array = empty(np.int8)

    def __post_init__(self) -> None:
        """Check that there are width * height cells with valid values."""
        cells = self.info.width * self.info.height
        if self.data.size != cells:
            reject(self, "data", self.data, f"must have width * height = {cells} cells")
        if cells and not (self.data.min() >= -1 and self.data.max() <= 100):
            reject(self, "data", self.data, "must hold values from -1 to 100")
        if cells and self.info.resolution == 0:
            reject(self, "info.resolution", 0.0, "must be above 0 where there are cells")


@message("nav_msgs/msg/Path")
class Path:
    """Poses to follow, in order."""

    header: Header = Header()
    poses: tuple[PoseStamped, ...] = ()
