"""The deployments of docs/drivers/base.md pass the check and name existing parameters."""

import re
from pathlib import Path

from cairn.components.roboclaw_base.config import RoboclawBaseConfig
from cairn.components.ros2_devices.config import Ros2BaseConfig
from cairn.components.velocity_gate.component import VelocityGate
from cairn.deployment.load import load_deployment
from cairn.runtime.ports import ports_of

PAGE = Path(__file__).parents[3] / "docs" / "drivers" / "base.md"
OTHER_NAMES = {"roboclaw_base", "ros2_base", "base_link", "base_footprint"} | {
    *("battery_state", "diff_drive_controller", "cmd_vel_timeout", "external_topics")
}


def block(title: str) -> str:
    fence = rf'^```yaml title="{re.escape(title)}"\n(.*?)^```'
    found = re.search(fence, PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert found, f"{PAGE.name} shows no {title}"
    return found[1]


def test_base_behind_ros_2_passes_the_check_with_and_without_overlay(
    tmp_path: Path,
) -> None:
    rover, jazzy = tmp_path / "rover.yaml", tmp_path / "jazzy.yaml"
    rover.write_text(block("rover.yaml"))
    jazzy.write_text(block("jazzy.yaml"))

    load_deployment(rover)
    load_deployment(rover, [jazzy])


def test_base_on_a_roboclaw_passes_the_check(tmp_path: Path) -> None:
    body = "".join(f"  {line}\n" for line in block("base.yaml").splitlines())
    file = tmp_path / "robot.yaml"
    file.write_text(f"cairn: 1\nexternal_topics: [cmd_vel]\ncomponents:\n{body}")

    load_deployment(file)


def test_page_names_only_existing_parameters() -> None:
    gate = {*VelocityGate.config_class().model_fields, *ports_of(VelocityGate)}
    fields = {*RoboclawBaseConfig.model_fields, *Ros2BaseConfig.model_fields, *gate}
    named = set(re.findall(r"`(\w+_\w+)(?:: \w+)?`", PAGE.read_text()))

    assert {"wheel_radius", "command_timeout_s", "stamp_on_arrival"} <= named
    assert named - fields <= OTHER_NAMES
