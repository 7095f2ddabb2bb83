"""The frames of a deployment are published once, latched, with the robot description."""

from pathlib import Path

import pytest

from cairn import CairnError
from cairn.components.ros_interface.robot_frames import RobotFramesPublisher
from cairn.deployment.model import Frame
from cairn.schemas.std_msgs import String
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing.lockstep import ComponentHarness, DeploymentHarness
from cairn.tf import Buffer, read_urdf

URDF = """<robot name="rover"><link name="base_footprint"/><link name="base_link"/>
  <joint name="a" type="fixed"><parent link="base_footprint"/><child link="base_link"/>
    <origin xyz="0 0 0.1"/></joint></robot>"""


def published(message: TFMessage) -> dict[str, str]:
    return {one.child_frame_id: one.header.frame_id for one in message.transforms}


def test_frames_are_published_with_a_description_that_has_their_links() -> None:
    frames = {"mast": Frame(x=0.1, z=1.0), "laser": Frame(parent="mast", theta=0.5)}
    component = ComponentHarness(RobotFramesPublisher, {"frames": frames})

    (message,) = component.take("tf_static")
    (description,) = component.take("robot_description")

    assert published(message) == {"mast": "base_link", "laser": "mast"}
    assert read_urdf(description.data).links == ("base_link", "mast", "laser")
    with pytest.raises(CairnError, match="cannot change while it runs"):
        component.set_parameters({"robot_description": "other.urdf"})


def test_deployment_publishes_its_description_and_frames_on_it(tmp_path: Path) -> None:
    (tmp_path / "rover.urdf").write_text(URDF)
    file = tmp_path / "robot.yaml"
    file.write_text("""
cairn: 1
robot: rover
robot_description: "${here}/rover.urdf"
frames: {laser: {parent: base_footprint, z: 0.3}}
components: {boss: {plugin: supervisor}}
""")
    with DeploymentHarness(file) as run:
        messages, texts = run.read("tf_static", TFMessage), run.read("robot_description", String)
        run.run_for(0.1)

    (message,), (text,) = messages.messages, texts.messages
    assert text.data == URDF
    buffer = Buffer()
    buffer.add(message, static=True)
    assert buffer.lookup("base_link", "laser").translation == pytest.approx((0.0, 0.0, 0.2))
