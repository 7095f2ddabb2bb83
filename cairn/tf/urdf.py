"""The joints of a robot description (URDF): read from one, or written as one.

Format: wiki.ros.org/urdf/XML. Only names, joint types and origins are read.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.etree import ElementTree
from xml.parsers import expat

from cairn.limits.files import RefusedFileError, read_text_bounded
from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.std_msgs import Header
from cairn.tf.errors import InvalidArgumentError, RobotDescriptionError
from cairn.tf.transform import Transform

MOST_BYTES: Final = 4_000_000
"""Longest robot description that is read [bytes]."""

MOST_LINKS: Final = 10_000
"""Largest number of links, and of joints."""

_MOST_ELEMENTS = 200_000
_LARGEST_ANGLE = 2.0 * math.pi + 1e-3  # [rad]; degrees are more, as a rule
_DEEPEST = 100
_LONGEST_NAME = 255
_MOVABLE = ("revolute", "continuous", "prismatic", "floating", "planar")


@dataclass(frozen=True)
class Joint:
    """A joint between two links.

    Attributes:
        name: name of the joint.
        type: `fixed`, or how the joint moves.
        parent: name of the parent link.
        child: name of the child link.
        transform: pose of the child in the parent, that of a movable joint at position 0.
    """

    name: str
    type: str
    parent: str
    child: str
    transform: Transform

    @property
    def is_fixed(self) -> bool:
        """Whether the joint does not move, so that its transform is static."""
        return self.type == "fixed"

    def message(self) -> TransformStamped:
        """Return the transform parent -> child as a message with stamp 0."""
        return TransformStamped(
            header=Header(frame_id=self.parent),
            child_frame_id=self.child,
            transform=self.transform.to_message(),
        )


@dataclass(frozen=True)
class RobotDescription:
    """What a robot description says of its frames.

    Attributes:
        name: name of the robot.
        root: the link that has no parent.
        links: names of all links, in the order of the description.
        joints: all joints, in the order of the description.
        text: the XML.
    """

    name: str
    root: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    text: str

    @property
    def static_transforms(self) -> tuple[TransformStamped, ...]:
        """Transforms parent -> child of the fixed joints, with stamp 0."""
        return tuple(joint.message() for joint in self.joints if joint.is_fixed)

    @property
    def movable_joints(self) -> tuple[str, ...]:
        """Names of the joints that are not fixed.

        Their transforms are not static, and have to be published by what knows their positions.
        """
        return tuple(joint.name for joint in self.joints if not joint.is_fixed)


def read_urdf_file(path: Path) -> RobotDescription:
    """Read a robot description from a file.

    Raises `RobotDescriptionError` if it cannot be read, or as `read_urdf`.
    """
    try:
        text = read_text_bounded(path, MOST_BYTES)
    except RefusedFileError as error:
        raise RobotDescriptionError(f"{path}: {error.strerror}; {error.remedy}") from error
    except OSError as error:
        raise RobotDescriptionError(
            f"{path}: it cannot be read: {error.strerror}; give a robot description (URDF)"
        ) from error
    except UnicodeDecodeError as error:
        raise RobotDescriptionError(
            f"{path}: it is not UTF-8 text ({error.reason}); save it as UTF-8"
        ) from error
    return read_urdf(text, str(path))


def read_urdf(text: str, source: str = "robot description") -> RobotDescription:
    """Read a robot description from its XML text.

    Args:
        text: the XML, as on topic `robot_description`.
        source: what errors call it.

    Raises:
        RobotDescriptionError: if it is not valid, declares a document type or entities, or is
            larger than this module's limits.
    """
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > MOST_BYTES:
        raise RobotDescriptionError(
            f"{source}: it has {size} bytes, more than the {MOST_BYTES} that are allowed; give a "
            "smaller robot description"
        )
    reader = _UrdfReader(source)
    try:
        reader.parse(text)
        return reader.description(text)
    except expat.ExpatError as error:
        raise RobotDescriptionError(f"{source}: it is not XML: {error}; correct it") from error
    except UnicodeEncodeError as error:
        raise RobotDescriptionError(
            f"{source}: it is not Unicode text ({error.reason}); correct it"
        ) from error


def write_urdf(name: str, root: str, joints: Sequence[Joint]) -> str:
    """Return the text of a robot description with fixed joints below the link `root`."""
    robot = ElementTree.Element("robot", name=name)
    for link in (root, *(joint.child for joint in joints)):
        ElementTree.SubElement(robot, "link", name=link)
    for joint in joints:
        element = ElementTree.SubElement(robot, "joint", name=joint.name, type=joint.type)
        xyz, rpy = joint.transform.translation, joint.transform.roll_pitch_yaw()
        ElementTree.SubElement(element, "origin", xyz=_text(xyz), rpy=_text(rpy))
        ElementTree.SubElement(element, "parent", link=joint.parent)
        ElementTree.SubElement(element, "child", link=joint.child)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=False)


@dataclass
class _ReadJoint:
    name: str
    type: str
    parent: str = ""
    child: str = ""
    xyz: str = "0 0 0"
    rpy: str = "0 0 0"

    def joint(self, source: str) -> Joint:
        try:
            x, y, z = _three_numbers(self.xyz)
            angles = _three_numbers(self.rpy)
            transform = Transform.from_roll_pitch_yaw(*angles, (x, y, z))
        except (ValueError, InvalidArgumentError) as error:
            raise RobotDescriptionError(
                f"{source}: joint {self.name}: origin xyz={self.xyz[:80]!r} rpy={self.rpy[:80]!r} "
                "are not three finite numbers each; correct it, and expand it first if it is xacro"
            ) from error
        if max(map(abs, angles)) > _LARGEST_ANGLE:
            raise RobotDescriptionError(
                f"{source}: joint {self.name}: origin rpy={self.rpy[:80]!r} has an angle of more "
                "than a turn; give it in radians, such as 1.5708 for 90 degrees"
            )
        return Joint(self.name, self.type, self.parent, self.child, transform)


@dataclass
class _UrdfReader:
    """Keeps links and joints while expat reads; nothing else of the document is kept."""

    source: str
    robot: str | None = None
    links: list[str] = field(default_factory=list)
    joints: list[_ReadJoint] = field(default_factory=list)
    path: list[str] = field(default_factory=list)
    elements: int = 0

    def parse(self, text: str) -> None:
        parser = expat.ParserCreate("utf-8")
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.Parse(text.encode("utf-8"), True)

    def description(self, text: str) -> RobotDescription:
        """Return what was read, after it was checked to be one tree."""
        if not self.links:
            raise self._error("it has no links", "give a robot description with a link")
        self._check_unique(self.links, "link")
        self._check_unique([joint.name for joint in self.joints], "joint")
        known = set(self.links)
        for joint in self.joints:
            for link, role in ((joint.parent, "parent"), (joint.child, "child")):
                if not link:
                    raise self._error(f"joint {joint.name} has no {role}", f"add <{role} link=...>")
                if link not in known:
                    raise self._error(
                        f"joint {joint.name}: there is no link {link!r}",
                        "add the link, or rename it",
                    )
        children = {joint.child: joint for joint in self.joints}
        if len(children) < len(self.joints):
            (two, *_) = [one for one in self.joints if children[one.child] is not one]
            raise self._error(
                f"link {two.child} is the child of joints {two.name} and "
                f"{children[two.child].name}",
                "remove one of them",
            )
        roots = [link for link in self.links if link not in children]
        if len(roots) != 1:
            listed = ", ".join(roots[:10]) or "none, so joints form a loop"
            raise self._error(
                f"it has {len(roots)} root links ({listed})", "connect the links to one tree"
            )
        self._check_loops(roots[0])
        return RobotDescription(
            name=self.robot or "",
            root=roots[0],
            links=tuple(self.links),
            joints=tuple(joint.joint(self.source) for joint in self.joints),
            text=text,
        )

    def _start(self, element: str, attributes: dict[str, str]) -> None:
        self.elements += 1
        if self.elements > _MOST_ELEMENTS or len(self.path) >= _DEEPEST:
            raise self._error(
                f"it has more than {_MOST_ELEMENTS} elements, or is nested more than {_DEEPEST} "
                "levels deep",
                "give a smaller robot description",
            )
        self.path.append(element)
        if element.startswith("xacro:"):
            raise self._error(
                f"it is a xacro file (<{element[:80]}>)", "expand it: `xacro FILE > robot.urdf`"
            )
        match self.path:
            case ["robot"]:
                self.robot = attributes.get("name", "")
            case [_]:
                raise self._error(
                    f"its root element is {element[:80]}, not robot",
                    "give a robot description (URDF)",
                )
            case [_, "link"]:
                self.links.append(self._name(element, attributes))
            case [_, "joint"]:
                self.joints.append(self._joint(attributes))
            case [_, "joint", "origin"]:
                if unknown := sorted(attributes.keys() - {"xyz", "rpy"}):
                    raise self._error(
                        f"joint {self.joints[-1].name}: its origin has {unknown[0][:80]}",
                        "give its rotation as rpy, in radians",
                    )
                self.joints[-1].xyz = attributes.get("xyz", "0 0 0")
                self.joints[-1].rpy = attributes.get("rpy", "0 0 0")
            case [_, "joint", "parent"]:
                self.joints[-1].parent = attributes.get("link", "")
            case [_, "joint", "child"]:
                self.joints[-1].child = attributes.get("link", "")
        if max(len(self.links), len(self.joints)) > MOST_LINKS:
            raise self._error(
                f"it has more than {MOST_LINKS} links or joints", "give a smaller robot description"
            )

    def _end(self, _element: str) -> None:
        self.path.pop()

    def _refuse_doctype(self, *_: object) -> None:
        raise self._error(
            "it declares a document type, which may contain entities", "remove <!DOCTYPE ...>"
        )

    def _joint(self, attributes: dict[str, str]) -> _ReadJoint:
        joint = _ReadJoint(self._name("joint", attributes), attributes.get("type", ""))
        if joint.type != "fixed" and joint.type not in _MOVABLE:
            known = ", ".join(("fixed", *_MOVABLE))
            raise self._error(
                f"joint {joint.name}: {joint.type[:80]!r} is not a type of joint", f"use {known}"
            )
        return joint

    def _name(self, element: str, attributes: dict[str, str]) -> str:
        name = attributes.get("name", "")
        if "${" in name:
            raise self._error(
                f"a {element} has the name {name[:80]}, as in a xacro file",
                "expand it: `xacro FILE > robot.urdf`",
            )
        if not name or len(name) > _LONGEST_NAME:
            raise self._error(
                f"the name of a {element} has {len(name)} characters",
                f"give it 1 to {_LONGEST_NAME} characters",
            )
        return name

    def _check_unique(self, names: list[str], kind: str) -> None:
        known: set[str] = set()
        for name in names:
            if name in known:
                raise self._error(f"it has two {kind}s named {name}", "rename one of them")
            known.add(name)

    def _check_loops(self, root: str) -> None:
        """Check that all links are below the root: those of a loop are not."""
        below: dict[str, list[str]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint.child)
        waiting, reached = [root], 0
        while waiting:
            reached += 1
            waiting += below.get(waiting.pop(), ())
        if reached < len(self.links):
            raise self._error(
                f"{len(self.links) - reached} links are not below the root link {root}, because "
                "joints form a loop",
                "connect the links to one tree",
            )

    def _error(self, what: str, remedy: str) -> RobotDescriptionError:
        return RobotDescriptionError(f"{self.source}: {what}; {remedy}")


def _three_numbers(text: str) -> tuple[float, float, float]:
    x, y, z = map(float, text.split())
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(text)
    return x, y, z


def _text(numbers: tuple[float, float, float]) -> str:
    return " ".join(f"{number:.12g}" for number in numbers)
