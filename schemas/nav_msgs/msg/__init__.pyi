"""Messages of ROS 2 package nav_msgs."""

from cairn.schemas import field_types
from cairn.schemas.geometry_msgs import msg as geometry_msgs
from cairn.schemas.message import message
from cairn.schemas.std_msgs import msg as std_msgs

@message("nav_msgs/msg/Goals")
class Goals:
    header: std_msgs.Header = ...
    goals: tuple[geometry_msgs.PoseStamped, ...] = ...

@message("nav_msgs/msg/GridCells")
class GridCells:
    header: std_msgs.Header = ...
    cell_width: field_types.Float32 = ...
    cell_height: field_types.Float32 = ...
    cells: tuple[geometry_msgs.Point, ...] = ...

from cairn.schemas.nav_msgs import MapMetaData as MapMetaData

from cairn.schemas.nav_msgs import OccupancyGrid as OccupancyGrid

from cairn.schemas.nav_msgs import Odometry as Odometry

from cairn.schemas.nav_msgs import Path as Path
