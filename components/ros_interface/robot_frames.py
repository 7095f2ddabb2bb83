"""The component that publishes the frames of a robot, once for all of its components."""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from cairn import LATCHED, Component, Config, Out, ReadPath, from_ns
from cairn.deployment.model import Frame
from cairn.schemas.std_msgs import String
from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import BASE_FRAME, RobotFrames, read_urdf_file, write_urdf


class RobotFramesConfig(Config):
    """The frames of the robot."""

    frames: dict[str, Frame] = Field({}, description="Where frames are mounted, by their names.")
    robot_description: ReadPath | None = Field(
        None, description="File with a robot description (URDF), whose links are frames, too."
    )


class RobotFramesPublisher(Component):
    """Publishes the transforms of the robot's fixed frames, and the robot description (URDF).

    A deployment with `frames` or `robot_description` has this component without naming it. Without
    a file, the description has a link for each frame.
    """

    # Components have got the mounts at their start.
    live_parameters = frozenset()
    config: RobotFramesConfig

    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    robot_description: Out[String] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Read the robot description; raises `RobotDescriptionError`."""
        mounts = [frame.joint(name) for name, frame in self.config.frames.items()]
        file = self.config.robot_description
        if file is None:
            self._frames = RobotFrames(mounts)
            robot = self._context.launch.context.robot
            self._text = write_urdf(robot, BASE_FRAME, self._frames.joints)
        else:
            description = read_urdf_file(file)
            self._frames = RobotFrames((*description.joints, *mounts))
            self._text = description.text

    def on_activate(self) -> None:
        """Publish all of them."""
        stamp = from_ns(self.clock.now())
        transforms = tuple(
            replace(one, header=replace(one.header, stamp=stamp))
            for one in self._frames.static_transforms()
        )
        self.tf_static.publish(TFMessage(transforms=transforms))
        self.robot_description.publish(String(data=self._text))
