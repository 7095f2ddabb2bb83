"""The robot's deployment is the simulated robot's, with other drivers."""

import re
import textwrap
from pathlib import Path
from typing import Any

from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment

DEPLOY = Path(__file__).parents[2] / "deploy"
DRIVERS = {"base", "range_scanner", "stereo_camera"}


def test_robot_deployment_differs_from_the_simulated_one_only_in_drivers() -> None:
    real = _components(load_deployment(DEPLOY / "robot.yaml"))
    simulated = _components(
        load_deployment(DEPLOY / "sim.yaml", [DEPLOY / "pixels.yaml"], ["start=null"])
    )

    assert simulated.keys() - real.keys() == {"world"}
    assert {name for name in real if real[name] != simulated[name]} == DRIVERS
    for driver in DRIVERS:
        differing = {key for key in real[driver] if real[driver][key] != simulated[driver][key]}
        assert differing == {"plugin", "parameters"}


def test_overlay_replaces_all_drivers_by_those_of_ros2_nodes() -> None:
    robot = load_deployment(DEPLOY / "robot.yaml", [DEPLOY / "robot_ros2.yaml"])

    plugins = {name: robot.member(name).spec.plugin for name in DRIVERS}
    assert plugins == {
        "base": "ros2_base",
        "range_scanner": "ros2_scanner",
        "stereo_camera": "ros2_stereo_camera",
    }
    for name in ("range_scanner", "stereo_camera"):
        assert robot.member(name).spec.parameters == {}


def test_examples_of_the_guide_to_ros2_drivers_pass_the_check(tmp_path: Path) -> None:
    page = (DEPLOY.parent / "docs" / "how-to" / "ros2_robot.md").read_text(encoding="utf-8")
    mine = tmp_path / "my_ros2.yaml"
    blocks = re.findall(r"^```yaml(?: title=\S+)?\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    mine.write_text(blocks[0])
    robot = load_deployment(DEPLOY / "robot.yaml", [DEPLOY / "robot_ros2.yaml", mine])
    base, scanner = robot.member("base").spec, robot.member("range_scanner").spec
    assert base.topics == {"base_cmd_vel_stamped": "/cmd_vel", "base_odom": "/odom"}
    assert scanner.parameters["source_frame"] == "base_scan"

    images = [f"/{side}/image_raw" for side in ("left", "right")]
    topics = ["/odom", "/scan", *images, *(f"{one}/compressed" for one in images)]
    topics += [f"/{side}/camera_info" for side in ("left", "right")]
    supervisors = ("mobile_supervisor", "vision_supervisor")
    for block, supervisor in zip(blocks[1:], supervisors, strict=True):
        children = textwrap.indent(block, "      ")
        mine.write_text(
            f"external_topics: {topics}\ncomponents:\n  {supervisor}:\n    children:\n{children}"
        )
        load_deployment(DEPLOY / "robot.yaml", [DEPLOY / "robot_ros2.yaml", mine])


def test_overlay_removes_the_camera() -> None:
    robot = load_deployment(DEPLOY / "robot.yaml", [DEPLOY / "robot_without_camera.yaml"])

    assert {"base", "range_scanner", "localizer"} <= _components(robot).keys()
    assert not {"stereo_camera", "object_recognizer"} & _components(robot).keys()
    assert robot.member("map_builder").spec.parameters["grid_file"]


def test_service_bounds_memory_processes_and_log_messages() -> None:
    unit = (DEPLOY / "robot" / "cairn@.service").read_text(encoding="utf-8")
    settings = dict(line.split("=", 1) for line in unit.splitlines() if "=" in line)

    bounds = {"MemoryMax", "TasksMax", "LogRateLimitIntervalSec", "LogRateLimitBurst"}
    assert bounds <= settings.keys()
    stop_limit_s = load_deployment(DEPLOY / "robot.yaml").stop_limit_s
    assert stop_limit_s < float(settings["TimeoutStopSec"]) <= stop_limit_s + 10


def _components(deployment: Deployment) -> dict[str, dict[str, Any]]:
    return {
        member.name: {
            "parent": member.parent,
            **member.spec.model_dump(exclude={"children"}),
        }
        for member in deployment.members()
    }
