"""The static transforms of all publishers, as one message."""

from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.tf2_msgs import TFMessage

_MOST_FRAMES = 10_000  # as in a robot description


class StaticTransforms:
    """Collects static transforms, as a late subscriber of ROS gets the last message alone."""

    def __init__(self) -> None:
        self._of_child: dict[str, TransformStamped] = {}

    def add(self, message: TFMessage) -> TFMessage:
        """Add the transforms of a publisher; return the newest ones of all."""
        for one in message.transforms:
            if one.child_frame_id in self._of_child or len(self._of_child) < _MOST_FRAMES:
                self._of_child[one.child_frame_id] = one
        return TFMessage(transforms=tuple(self._of_child.values()))
