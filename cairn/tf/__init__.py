"""Transforms between frames: the buffer with their history, and fixed joints of a URDF.

```python
from cairn.tf import Buffer

buffer = Buffer()
buffer.add(message, static=False)  # a message of topic tf
points_in_map = buffer.lookup("map", "laser", stamp_ns).apply(points)
```
"""

from cairn.tf.buffer import Buffer, FrameInfo
from cairn.tf.errors import (
    BufferFullError,
    ConnectivityError,
    ExtrapolationError,
    InvalidArgumentError,
    RobotDescriptionError,
    TransformError,
    UnknownFrameError,
)
from cairn.tf.robot_frames import BASE_FRAME, RobotFrames
from cairn.tf.transform import Transform
from cairn.tf.urdf import Joint, RobotDescription, read_urdf, read_urdf_file, write_urdf

__all__ = [
    "BASE_FRAME",
    "Buffer",
    "BufferFullError",
    "ConnectivityError",
    "ExtrapolationError",
    "FrameInfo",
    "InvalidArgumentError",
    "Joint",
    "RobotDescription",
    "RobotDescriptionError",
    "RobotFrames",
    "Transform",
    "TransformError",
    "UnknownFrameError",
    "read_urdf",
    "read_urdf_file",
    "write_urdf",
]
