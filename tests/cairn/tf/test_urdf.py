"""Robot descriptions: fixed joints become static transforms, hostile texts are refused."""

import math
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import Buffer, RobotDescriptionError, read_urdf, read_urdf_file
from tests.wording import words_in_order

ROBOT = """<?xml version="1.0" encoding="ISO-8859-1"?>
<robot name="rover">
  <link name="base_link"><visual><origin xyz="9 9 9"/></visual></link>
  <link name="mast"/> <link name="camera"/> <link name="wheel"/>
  <joint name="mast_joint" type="fixed">
    <origin xyz="0.1 0 0.5" rpy="0.1 -0.2 1.5"/>
    <parent link="base_link"/> <child link="mast"/>
  </joint>
  <transmission name="drive"><joint name="wheel_joint"><origin xyz="7 7 7"/></joint></transmission>
  <joint name="camera_joint" type="fixed"><parent link="mast"/><child link="camera"/></joint>
  <joint name="wheel_joint" type="continuous">
    <parent link="base_link"/><child link="wheel"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""


def test_fixed_joints_are_static_transforms_and_the_others_are_named() -> None:
    robot = read_urdf(ROBOT)

    assert (robot.name, robot.root) == ("rover", "base_link")
    assert robot.links == ("base_link", "mast", "camera", "wheel")
    assert robot.movable_joints == ("wheel_joint",)
    edges = [(one.header.frame_id, one.child_frame_id) for one in robot.static_transforms]
    assert edges == [("base_link", "mast"), ("mast", "camera")]


def test_transforms_of_a_description_are_those_of_its_origins() -> None:
    buffer = Buffer()
    buffer.add(TFMessage(transforms=read_urdf(ROBOT).static_transforms), static=True)

    found = buffer.lookup("base_link", "camera")

    assert found.translation == pytest.approx((0.1, 0.0, 0.5))
    wanted = Rotation.from_euler("xyz", [0.1, -0.2, 1.5]).as_matrix()
    np.testing.assert_allclose(found.rotation_matrix(), wanted, atol=1e-12)
    assert math.isclose(found.roll_pitch_yaw()[2], 1.5)


def test_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "rover.urdf"
    file.write_text(ROBOT, encoding="utf-8")

    assert read_urdf_file(file) == read_urdf(ROBOT)


def joint(parent: str, child: str, name: str = "j", kind: str = "fixed", origin: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}">{origin}<parent link="{parent}"/>'
        f'<child link="{child}"/></joint>'
    )


def robot(*parts: str, links: str = "abc") -> str:
    return f"<robot>{''.join(f'<link name={one!r}/>' for one in links)}{''.join(parts)}</robot>"


LAUGHS = """<!DOCTYPE robot [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;">]><robot>&b;</robot>"""
FILE = """<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot>&a;</robot>"""
INVALID = {
    "entities": (LAUGHS, ("document type", "remove")),
    "external entity": (FILE, ("document type", "remove")),
    "undeclared entity": ("<robot>&a;</robot>", ("not XML", "undefined entity")),
    "too long": ("<robot>" + " " * 4_000_001, ("4000008 bytes", "smaller")),
    "many elements": ("<robot>" + "<a/>" * 200_001, ("200000 elements", "smaller")),
    "deep": ("<robot>" + "<a>" * 200, ("100 levels", "smaller")),
    "many links": (
        "<robot>" + "".join(f'<link name="{n}"/>' for n in range(10_001)),
        ("10000 links", "smaller"),
    ),
    "empty": ("", ("not XML",)),
    "not XML": ("robot: rover", ("not XML", "line 1")),
    "cut off": (ROBOT[:300], ("not XML",)),
    "surrogate": ("<robot name='\ud800'/>", ("not Unicode",)),
    "other root": ("<sdf/>", ("root element is sdf", "URDF")),
    "no links": ("<robot/>", ("no links",)),
    "link without a name": ("<robot><link/></robot>", ("name of a link", "0 characters")),
    "long name": (f"<robot><link name='{'a' * 256}'/></robot>", ("256 characters",)),
    "two links of a name": (robot(links="aa"), ("two links named a", "rename")),
    "two joints of a name": (
        robot(joint("a", "b"), joint("b", "c")),
        ("two joints named j", "rename"),
    ),
    "unknown link": (robot(joint("a", "z")), ("joint j", "no link 'z'")),
    "joint without a child": (
        robot('<joint name="j" type="fixed"><parent link="a"/></joint>'),
        ("joint j", "no child"),
    ),
    "type": (robot(joint("a", "b", kind="welded")), ("joint j", "welded", "revolute")),
    "no type": (robot('<joint name="j"/>'), ("joint j", "''", "fixed")),
    "two parents": (
        robot(joint("a", "c"), joint("b", "c", name="k")),
        ("link c", "joints j and k", "remove"),
    ),
    "two roots": (robot(joint("a", "b")), ("2 root links (a, c)", "one tree")),
    "only a loop": (
        robot(joint("a", "b"), joint("b", "a", name="k"), links="ab"),
        ("0 root links", "loop"),
    ),
    "loop beside the tree": (
        robot(joint("b", "c"), joint("c", "b", name="k")),
        ("2 links are not below the root link a", "loop"),
    ),
    "two numbers": (
        robot(joint("a", "b", origin='<origin xyz="1 2"/>'), links="ab"),
        ("joint j", "'1 2'", "three"),
    ),
    "not finite": (
        robot(joint("a", "b", origin='<origin xyz="nan 0 0"/>'), links="ab"),
        ("joint j", "nan", "finite"),
    ),
    "infinite angle": (
        robot(joint("a", "b", origin='<origin rpy="inf 0 0"/>'), links="ab"),
        ("joint j", "inf", "finite"),
    ),
    "xacro": (
        robot(joint("a", "b", origin='<origin xyz="${x} 0 0"/>'), links="ab"),
        ("joint j", "${x} 0 0", "xacro"),
    ),
}


@pytest.mark.parametrize("what", INVALID)
def test_invalid_description_is_refused_with_the_reason(what: str) -> None:
    text, words = INVALID[what]
    began = time.process_time()

    with pytest.raises(RobotDescriptionError, match=words_in_order("rover.urdf: ", *words)):
        read_urdf(text, "rover.urdf")

    assert time.process_time() - began < 10.0  # of the processor: a bomb takes for ever


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\xff\xfe<robot/>", ("not UTF-8", "save it as UTF-8")),
        (b" " * 4_000_001, ("4 MB", "smaller")),
    ],
    ids=["not UTF-8", "too long"],
)
def test_file_that_is_no_description_is_refused(
    tmp_path: Path, data: bytes, words: tuple[str, ...]
) -> None:
    file = tmp_path / "rover.urdf"
    file.write_bytes(data)

    with pytest.raises(RobotDescriptionError, match=words_in_order("rover.urdf", *words)):
        read_urdf_file(file)


def test_missing_file_and_device_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotDescriptionError, match=words_in_order("none.urdf", "No such file")):
        read_urdf_file(tmp_path / "none.urdf")
    with pytest.raises(RobotDescriptionError, match=words_in_order("/dev/zero", "device")):
        read_urdf_file(Path("/dev/zero"))
