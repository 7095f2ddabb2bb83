"""ROS package map_msgs: changes of maps."""

import numpy as np

from cairn.schemas.field_types import Int8Array, Int32, UInt32, empty
from cairn.schemas.message import message, reject
from cairn.schemas.std_msgs import Header


@message("map_msgs/msg/OccupancyGridUpdate")
class OccupancyGridUpdate:
    """New values of a window of a map: `width` x `height` cells starting at column `x`, row `y`."""

    header: Header = Header()
    x: Int32 = 0
    y: Int32 = 0
    width: UInt32 = 0
    height: UInt32 = 0
    data: Int8Array = empty(np.int8)

    def __post_init__(self) -> None:
        """Check that there are width * height cells with valid values."""
        cells = self.width * self.height
        if self.data.size != cells:
            reject(self, "data", self.data, f"must have width * height = {cells} cells")
        if cells and not (self.data.min() >= -1 and self.data.max() <= 100):
            reject(self, "data", self.data, "must hold values from -1 to 100")
