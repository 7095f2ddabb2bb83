"""ROS 2 package tf2_msgs: the tree of coordinate frames."""

from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.message import message


@message("tf2_msgs/msg/TFMessage", independent=("transforms",))
class TFMessage:
    """Transforms between frames, as on the topics tf and tf_static."""

    transforms: tuple[TransformStamped, ...] = ()
