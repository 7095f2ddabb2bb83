"""The frames of a robot: where the links of its joints are on its base."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from cairn.schemas.geometry_msgs import TransformStamped
from cairn.tf.errors import ConnectivityError, UnknownFrameError
from cairn.tf.transform import Transform
from cairn.tf.urdf import Joint

BASE_FRAME: Final = "base_link"
"""Frame of a robot's base, which odometry moves: REP 105."""


class RobotFrames:
    """The tree of a robot's joints, seen from its base.

    The base need not be the root of the joints: a link above it, such as `base_footprint`, becomes
    a child of the base, because a frame has one parent only, and that of the base is `odom`.
    """

    def __init__(self, joints: Iterable[Joint]) -> None:
        """Take joints without loops, of which none has the child of another one."""
        links: dict[str, list[Joint]] = {}
        for joint in joints:
            links.setdefault(joint.parent, []).append(joint)
            links.setdefault(joint.child, []).append(_turned(joint))
        self._joints: dict[str, Joint] = {}  # by child, away from the base
        waiting = deque([BASE_FRAME])
        while waiting:
            for joint in links.get(waiting.popleft(), ()):
                if joint.child != BASE_FRAME and joint.child not in self._joints:
                    self._joints[joint.child] = joint
                    waiting.append(joint.child)

    @property
    def names(self) -> tuple[str, ...]:
        """The frames that joints connect to the base, the base first."""
        return (BASE_FRAME, *self._joints)

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The joints by which they are connected, each with the parent that is nearer the base."""
        return tuple(self._joints.values())

    def pose(self, frame: str) -> Transform:
        """Return the pose of a frame on the base.

        Raises:
            UnknownFrameError: if no joints connect the frame to the base.
            ConnectivityError: if one of them is not fixed.
        """
        pose, link = Transform(), frame
        while link != BASE_FRAME:
            joint = self._joints.get(link)
            if joint is None:
                raise UnknownFrameError(
                    f"there is no frame {frame} on the robot; it has {', '.join(self.names)}"
                )
            if not joint.is_fixed:
                raise ConnectivityError(
                    f"joint {joint.name} between {BASE_FRAME} and {frame} is {joint.type}, so the "
                    "frame has no fixed pose on the robot; make the joint fixed, or name another "
                    "frame"
                )
            pose, link = joint.transform @ pose, joint.parent
        return pose

    def static_transforms(self) -> tuple[TransformStamped, ...]:
        """Return the transforms of the fixed joints, with stamp 0."""
        return tuple(joint.message() for joint in self.joints if joint.is_fixed)


def _turned(joint: Joint) -> Joint:
    return Joint(joint.name, joint.type, joint.child, joint.parent, joint.transform.inverse())
