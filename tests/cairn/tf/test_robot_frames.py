"""A robot's frames are a tree below its base, whatever the root of its description is."""

import math

import pytest

from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import (
    Buffer,
    ConnectivityError,
    Joint,
    RobotFrames,
    Transform,
    UnknownFrameError,
    read_urdf,
    write_urdf,
)
from tests.wording import words_in_order

BASE = Joint(
    "base", "fixed", "base_footprint", "base_link", Transform.from_pose2d(0.5, 0, math.pi / 2)
)
MAST = Joint("mast", "fixed", "base_footprint", "mast", Transform((0.5, 0.2, 1.0)))
LASER = Joint("laser", "fixed", "mast", "laser", Transform.from_pose2d(0.1, 0.0, 0.0))
WHEEL = Joint("axle", "continuous", "base_link", "wheel", Transform())
CAP = Joint("cap", "fixed", "wheel", "cap", Transform((0.0, 0.01, 0.0)))


def test_frames_above_the_base_become_its_children() -> None:
    """`base_link` has the parent `odom` already, so it cannot have another one."""
    frames = RobotFrames([BASE, MAST, LASER, WHEEL, CAP])
    buffer = Buffer()
    buffer.add(TFMessage(transforms=frames.static_transforms()), static=True)

    parents = {one.child_frame_id: one.header.frame_id for one in frames.static_transforms()}
    assert parents == {
        "base_footprint": "base_link",
        "mast": "base_footprint",
        "laser": "mast",
        "cap": "wheel",
    }
    assert frames.pose("laser").translation == pytest.approx((0.2, -0.1, 1.0))
    assert frames.pose("laser").pose2d()[2] == pytest.approx(-math.pi / 2)
    known = buffer.lookup("base_link", "laser")
    assert known.translation == pytest.approx(frames.pose("laser").translation)


def test_frame_behind_a_movable_joint_has_no_fixed_pose() -> None:
    with pytest.raises(ConnectivityError, match=words_in_order("axle", "cap", "continuous")):
        RobotFrames([WHEEL, CAP]).pose("cap")
    with pytest.raises(UnknownFrameError, match="camera"):
        RobotFrames([BASE]).pose("camera")


def test_written_description_is_read_as_the_same_joints() -> None:
    turned = Transform.from_roll_pitch_yaw(0.1, -0.2, 1.5, (0.1, 0.0, 0.5))
    joint = Joint('"<&>', "fixed", "base_link", "a", turned)

    found = read_urdf(write_urdf("rover", "base_link", [joint]))

    assert (found.name, found.root, found.links) == ("rover", "base_link", ("base_link", "a"))
    (again,) = found.joints
    assert again.name == joint.name
    assert again.transform.motion == pytest.approx(turned.motion, abs=1e-9)
