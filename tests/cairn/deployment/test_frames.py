"""Mounts are given once, below `frames` or in a URDF; parameters refer to them."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cairn.deployment.load import load_deployment
from cairn.deployment.problems import DeploymentError
from cairn.deployment.shipped import deployment_file
from tests.wording import assert_words

Write = Callable[..., Path]

ROBOT = """
    cairn: 1
    settings: {ahead: 0.1}
    frames:
      mast: {x: "${ahead}", z: 1.0, theta: 1.5707963267948966}
      laser: {parent: mast, x: 0.2, z: 0.25}
      back: {x: -0.3, theta: 3.141592653589793}
    components:
      one:
        plugin: acme_supervisor
        parameters: {value: "${frames.laser}"}
"""
URDF = """
    <robot name="rover"><link name="base_footprint"/><link name="base_link"/><link name="top"/>
      <link name="tilted"/><link name="upside.down"/><link name="wheel"/><link name="hub"/>
      <joint name="a" type="fixed"><parent link="base_footprint"/><child link="base_link"/></joint>
      <joint name="b" type="fixed"><parent link="base_link"/><child link="top"/>
        <origin xyz="0.1 0.2 0.3" rpy="0 0 0.5"/></joint>
      <joint name="c" type="fixed"><parent link="top"/><child link="tilted"/>
        <origin rpy="0 0.4 0"/></joint>
      <joint name="d" type="fixed"><parent link="top"/><child link="upside.down"/>
        <origin rpy="3.14159 0 0"/></joint>
      <joint name="e" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
      <joint name="f" type="fixed"><parent link="wheel"/><child link="hub"/></joint>
    </robot>
    """


def value(file: Path, reference: str, *sets: str) -> Any:
    """Return the value of a reference among the parameters, without the plugins."""
    given = f"components.one.parameters.value={reference!r}"
    deployment = load_deployment(file, sets=[*sets, given], import_plugins=False)
    return deployment.member("one").spec.parameters["value"]


def problems(file: Path, *sets: str) -> str:
    with pytest.raises(DeploymentError) as raised:
        load_deployment(file, sets=sets, import_plugins=False)
    return str(raised.value)


def test_reference_to_a_frame_is_its_pose_on_the_base(write: Write) -> None:
    file = write(ROBOT)

    assert value(file, "${frames.laser}") == {"x": 0.1, "y": 0.2, "theta": 1.570796326795}
    assert value(file, "${frames.back}") == {"x": -0.3, "y": 0.0, "theta": math.pi}
    assert value(file, "${frames.laser.z}") == 1.25
    assert value(file, "at ${frames.mast.x}") == "at 0.1"
    moved = ("frames.laser.x=0.4", "ahead=0.3")
    assert value(file, "${frames.laser}", *moved) == {"x": 0.3, "y": 0.4, "theta": 1.570796326795}


def test_frames_are_also_the_links_of_a_robot_description(write: Write) -> None:
    write(URDF, "rover.urdf")
    file = write(ROBOT + '    robot_description: "${here}/rover.urdf"\n')

    assert value(file, "${frames.top}") == {"x": 0.1, "y": 0.2, "theta": 0.5}
    assert value(file, "${frames.top}", "frames.laser.parent=top") is not None
    assert value(file, "${frames.tilted.z}") == 0.3
    laser = value(file, "${frames.laser}", "frames.laser={parent: top, x: 1.0}")
    assert laser["x"] == pytest.approx(0.1 + math.cos(0.5))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("frames.laser.parent=mst", ("frames.laser.parent: there is no frame mst", "mean mast")),
        ("frames.mast.parent=laser", ("frames.mast.parent", "circular", "mast -> laser -> mast")),
        ("frames.laser.x=9", ("frames.laser.x", "9", "5")),
        ("frames.laser.yaw=1", ("frames.laser.yaw", "there is no yaw here")),
        ("frames.lasr.x=1", ("--set", "there is no frame lasr", "did you mean laser")),
        ("frames.base_link={}", ("frames.base_link", "the robot's base", "rename")),
        ("settings.ahead=${frames.mast.x}", ("settings.ahead", "mast", "below components only")),
        ("frames=null", ("robot.yaml:10", "there is no frame laser", "expected one of", "top")),
        ("robot_description=${nope}.urdf", ("robot_description: there is no setting nope",)),
        ("robot_description=none.urdf", ("robot_description: none.urdf", "No such file", "give")),
        ("frames.top={x: 1}", ("frames.top", "link of robot_description", "rename")),
        ("${frames.tilted}", ("tilted by 23 degrees", "level")),
        ("${frames.upside.down}", ("upside.down is tilted by 180 degrees", "level")),
        ("${frames.hub}", ("joint e between base_link and hub is continuous", "fixed")),
        ("${frames.topp}", ("no frame topp", "did you mean top")),
    ],
)
def test_problems_name_key_and_remedy(write: Write, change: str, words: tuple[str, ...]) -> None:
    write(URDF, "rover.urdf")
    file = write(ROBOT + "    robot_description: rover.urdf\n")
    if change.startswith("$"):
        change = f"components.one.parameters.value={change}"

    text = problems(file, change)

    assert_words(text, "1 problem", *words)


def test_overlay_adds_and_removes_frames(write: Write) -> None:
    overlay = write("frames: {laser: null, camera: {parent: mast, x: 1.0}}", "overlay.yaml")
    sets = ["components.one.parameters.value='${frames.camera}'"]

    deployment = load_deployment(write(ROBOT), [overlay], sets, import_plugins=False)

    assert deployment.frames.keys() == {"mast", "back", "camera"}
    value = deployment.member("one").spec.parameters["value"]
    assert (value["x"], value["y"]) == (0.1, 1.0)


def test_one_component_publishes_the_frames_of_a_robot_that_has_some(write: Write) -> None:
    file = write(ROBOT)

    names = [one.name for one in load_deployment(file, import_plugins=False).members()]
    assert names == ["robot_frames", "one"]
    sets = ["frames=null", "components.one.parameters=null"]
    assert [
        one.name for one in load_deployment(file, sets=sets, import_plugins=False).members()
    ] == ["one"]
    taken = problems(file, "components={robot_frames: {plugin: acme_supervisor}}")
    assert_words(taken, "components.robot_frames", "another name")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("frames.odom={x: 1}", ("components.localizer.plugin", "odom, which frames has", "remove")),
        (
            "frames.left_camera_optical_frame={}",
            ("components.stereo_camera.plugin", "left_camera_optical_frame", "remove"),
        ),
        (
            "components.stereo_camera.parameters.mount_frame=head",
            ("components.stereo_camera.parameters.mount_frame", "no frame head", "laser, camera"),
        ),
    ],
)
def test_each_frame_of_components_is_published_once(change: str, words: tuple[str, ...]) -> None:
    sim, pixels = deployment_file("sim"), deployment_file("pixels")

    with pytest.raises(DeploymentError) as raised:
        load_deployment(sim, [pixels], [change])

    assert_words(str(raised.value), "1 problem", *words)
    if "head" in change:
        load_deployment(sim, [pixels], [change, "external_topics=[tf_static]"])
