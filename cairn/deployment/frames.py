"""The frames of a deployment's robot: from its keys `frames` and `robot_description`."""

import math
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from cairn.deployment.model import Frame
from cairn.deployment.problems import Location, Problem, suggestion
from cairn.deployment.yaml_document import DocumentNode
from cairn.errors import CairnError
from cairn.tf.errors import RobotDescriptionError
from cairn.tf.robot_frames import BASE_FRAME, RobotFrames
from cairn.tf.transform import Transform
from cairn.tf.urdf import RobotDescription, read_urdf_file

FRAMES: Final = "frames"
DESCRIPTION: Final = "robot_description"

_MOST_TILT_RAD = math.radians(5.0)  # at 10 m, a beam is 0.9 m above or below the plane
_NUMBERS = ("x", "y", "z", "theta")
_DECIMALS = 12  # so that a yaw of 0.1 remains 0.1 after its conversion to a quaternion


class FrameReferenceError(CairnError):
    """A reference to a frame has no value."""


class FrameReferences:
    """The values of `${frames.NAME}`: poses on the robot.

    Attributes:
        problems: what is wrong with the two keys, without invalid values of a frame, which the
            model of a deployment rejects.
    """

    def __init__(self, frames: DocumentNode | None, description: DocumentNode | None) -> None:
        self.problems: list[Problem] = []
        self._frames = frames.entries if frames is not None else {}
        self._description = description
        described = self._read_description()
        self._is_partly_unknown = bool(self.problems)
        mounts = self._mounts((BASE_FRAME,) if described is None else described.links)
        joints = () if described is None else described.joints
        self._tree = RobotFrames((*joints, *(mounts[name].joint(name) for name in mounts)))

    @property
    def names(self) -> tuple[str, ...]:
        """The frames of the robot that are right, the base first."""
        return self._tree.names

    def value(self, name: str, at: Location) -> DocumentNode | None:
        """Return the value of `${frames.NAME}` at `at`, or of `${frames.NAME.x}`, y, z or theta.

        That of a frame is its pose in the plane of the base: x, y [m], theta [rad]. It is None if
        the frame is given, but wrong.

        Raises `FrameReferenceError` if there is no such frame, if it can move on the robot, or if
        it is tilted and more of it is needed than its position.
        """
        frame, _, number = name.rpartition(".")
        if name in self._frames or name in self._tree.names or number not in _NUMBERS:
            frame, number = name, ""
        if frame not in self._tree.names:
            if frame in self._frames or self._is_partly_unknown:
                return None
            known = dict.fromkeys((*self._tree.names[1:], *self._frames))
            raise FrameReferenceError(
                f"there is no frame {frame}; {suggestion(frame, known)}"
                if known
                else f"there is no frame {frame}; add it below {FRAMES}"
            )
        pose = self._tree.pose(frame)
        if number in ("", "theta"):
            _check_level(frame, pose)
        node = self._frames.get(frame) or self._description
        if node is not None:
            at = node.where
        x, y, z = (round(one, _DECIMALS) for one in pose.translation)
        theta = max(-math.pi, min(math.pi, round(pose.pose2d()[2], _DECIMALS)))
        values = {
            key: DocumentNode(value, at, at)
            for key, value in zip(_NUMBERS, (x, y, z, theta), strict=True)
        }
        if number:
            return values[number]
        del values["z"]
        return DocumentNode(values, at, at)

    def _read_description(self) -> RobotDescription | None:
        node = self._description
        if node is None or not isinstance(node.value, str):
            return None
        try:
            description = read_urdf_file(Path(node.value))
        except RobotDescriptionError as error:
            found, _, remedy = str(error).rpartition("; ")
            self._report(node, DESCRIPTION, found, remedy)
            return None
        if BASE_FRAME not in description.links:
            found = f"{node.value}: it has no link {BASE_FRAME}, which is the robot's base"
            remedy = "add it, or rename the link that odometry moves"
            self._report(node, DESCRIPTION, found, remedy)
            return None
        return description

    def _mounts(self, links: tuple[str, ...]) -> dict[str, Frame]:
        """Return the frames that are mounted on a link or on each other, without invalid ones."""
        mounts: dict[str, Frame] = {}
        for name, node in self._frames.items():
            try:
                frame = Frame.model_validate(node.plain())
            except ValidationError:
                continue
            if name in links:
                what = "the robot's base" if name == BASE_FRAME else "a link of robot_description"
                found = f"{name} is {what} and has its place already"
                self._report(node, f"{FRAMES}.{name}", found, "remove it, or rename it")
                continue
            mounts[name] = frame
        known, looped = dict.fromkeys((*links, *self._frames)), set[str]()
        for name, frame in mounts.items():
            at, path = self._frames[name].find("parent") or self._frames[name], f"{name}.parent"
            if frame.parent not in known and not self._is_partly_unknown:
                found, remedy = (
                    f"there is no frame {frame.parent}",
                    suggestion(frame.parent, (one for one in known if one != name)),
                )
                self._report(at, f"{FRAMES}.{path}", found, remedy)
            chain = [name]
            while chain[-1] in mounts and mounts[chain[-1]].parent not in chain:
                chain.append(mounts[chain[-1]].parent)
            if chain[-1] in mounts and name not in looped and mounts[chain[-1]].parent == name:
                looped.update(chain)
                found = f"circular frames: {' -> '.join([*chain, name])}"
                self._report(at, f"{FRAMES}.{path}", found, f"mount one of them on {BASE_FRAME}")
        return mounts

    def _report(self, node: DocumentNode, path: str, found: str, remedy: str) -> None:
        self.problems.append(Problem(node.where, path, found, remedy))


def _check_level(frame: str, pose: Transform) -> None:
    """Raise `FrameReferenceError` if a frame has no pose in the plane."""
    upright = float(pose.rotation_matrix()[2, 2])
    if upright < math.cos(_MOST_TILT_RAD):
        tilt = math.degrees(math.acos(max(-1.0, upright)))
        raise FrameReferenceError(
            f"the frame {frame} is tilted by {tilt:.0f} degrees on {BASE_FRAME}, and only a level "
            "one has a pose in the plane; mount the sensor level, or refer to a level frame"
        )
