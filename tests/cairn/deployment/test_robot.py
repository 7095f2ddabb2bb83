"""The section `robot`: components take their defaults from it, and contradictions are named."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cairn import CairnError, FromRobot
from cairn.deployment.load import contradictions_of, load_deployment, read_names, read_sources
from cairn.deployment.problems import DeploymentError
from cairn.deployment.shipped import deployment_file
from tests.commands import cairn
from tests.wording import assert_words

Write = Callable[..., Path]
SIM = deployment_file("sim")

ROVER = """
    cairn: 1
    robot:
      name: rover
      shape: {radius_m: 0.3}
      limits: {speed_m_s: 0.5}
    external_topics: [odom, scan, navigator_cmd_vel]
    frames: {laser: {x: 0.2}, low: {x: 0.4, z: 0.1}}
    components:
      velocity_gate: {plugin: velocity_gate}
"""


def gate(file: Path, *sets: str) -> dict[str, Any]:
    return load_deployment(file, sets=sets).components["velocity_gate"].parameters


def test_components_have_the_values_of_the_robot_by_default(write: Write) -> None:
    file = write(ROVER)

    assert gate(file) == {
        "radius": 0.3, "speed": 0.5, "mount": {"x": 0.2, "y": 0.0, "theta": 0.0},
    }  # fmt: skip
    assert gate(file, "robot.mounts.scanner=low")["mount"]["x"] == 0.4
    assert gate(file, "robot.shape.radius_m=0.4")["radius"] == 0.4
    own = gate(file, "components.velocity_gate.parameters={radius: 0.5, mount: {y: 0.1}}")
    assert (own["radius"], own["mount"]) == (0.5, {"y": 0.1})
    assert "radius" not in gate(file, "robot.shape=null")


def test_name_alone_changes_nothing_else(write: Write, tmp_path: Path) -> None:
    file, overlay = write(ROVER), tmp_path / "lab.yaml"
    overlay.write_text("robot: lab_rover\n")

    for deployment in (
        load_deployment(file, [overlay]),
        load_deployment(file, (), ["robot=lab_rover"]),
    ):
        assert deployment.robot.name == "lab_rover"
        assert deployment.robot.shape.radius_m == 0.3
    assert read_names(file, [overlay]).robot == "lab_rover"
    bare = write(
        ROVER.replace(
            """
      name: rover
      shape: {radius_m: 0.3}
      limits: {speed_m_s: 0.5}""",
            " rover",
        )
    )
    assert load_deployment(bare).robot.name == read_names(bare).robot == "rover"
    shaped = load_deployment(bare, (), ["robot.shape.radius_m=0.4"])
    assert (shaped.robot.name, shaped.robot.shape.radius_m) == ("rover", 0.4)


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("robot.shape.radius=0.3", ("robot.shape.radius", "did you mean radius_m")),
        ("robot.shape.radius_m=0", ("robot.shape.radius_m", "greater than 0", "Radius")),
        ("robot.drive.kind=legs", ("robot.drive.kind", "differential")),
        ("robot.name=Rover", ("robot.name", "Rover")),
        ("robot.mounts.scanner=lasr", ("robot.mounts.scanner: there is no frame lasr", "laser")),
        ("robot.shape.radius_m=3", ("components.velocity_gate.parameters.radius: 3", "<= 2")),
    ],
)
def test_mistake_is_reported_once_where_it_is_written(
    write: Write, assignment: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(DeploymentError) as raised:
        load_deployment(write(ROVER), (), [assignment])

    assert len(raised.value.problems) == 1
    assert_words(str(raised.value), f"--set {assignment}", *words)


def test_contradiction_is_a_warning_with_both_lines(write: Write) -> None:
    file = write(
        ROVER.replace(
            "{plugin: velocity_gate}",
            """
        plugin: velocity_gate
        parameters: {radius: 0.25, speed: 0.4, mount: {x: 0.2}}
    """,
        )
    )

    shown = cairn("check", str(file))

    assert shown.code == 0
    (warning,) = [line for line in shown.err.splitlines() if "warning" in line]
    assert_words(
        warning, f"{file.name}:11", "velocity_gate.parameters.radius: 0.25 differs",
        "robot.shape.radius_m, 0.3", f"{file.name}:4", "remove",
    )  # fmt: skip
    faster = ["components.velocity_gate.parameters.speed=0.6"]
    assert len(contradictions_of(read_sources(file), faster)) == 2


def test_fallback_with_a_plugin_of_its_own_has_its_own_defaults(tmp_path: Path) -> None:
    overlay = tmp_path / "machines.yaml"
    overlay.write_text("""
machines: {base: {address: 127.0.0.1}, brain: {address: 127.0.0.1, port: 7449}}
components:
  mobile_supervisor:
    children:
      automove:
        children:
          localizer: {machine: brain, fallback: {plugin: path_planner}}
""")
    fallback = load_deployment(SIM, [overlay]).member("localizer_fallback").spec

    assert fallback.parameters.keys() == {"radius", "speed", "mount"}


def test_unknown_quantity_of_the_robot_is_rejected_where_it_is_declared() -> None:
    with pytest.raises(CairnError, match=r"no quantity shape.radius; did you mean shape.radius_m"):
        FromRobot("shape.radius")


def test_shipped_deployments_do_not_contradict_themselves() -> None:
    for name in ("sim", "mapping", "robot", "replay_carmen", "replay_mrclam"):
        assert contradictions_of(read_sources(deployment_file(name))) == []
