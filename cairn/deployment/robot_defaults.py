"""The defaults that components have from the section `robot`, and what contradicts it.

The `Config` of a plugin declares them: `radius: Annotated[float, FromRobot("shape.radius_m")]`.
They become parameters of the components as the deployment is loaded, with the location of the
robot's value, so that everything that reads parameters has them.
"""

from collections.abc import Iterator
from typing import NamedTuple

from pydantic import ValidationError

from cairn.deployment.frames import DESCRIPTION, FRAMES, FrameReferenceError, FrameReferences
from cairn.deployment.plugins import PluginError, load_plugin
from cairn.deployment.problems import Problem
from cairn.deployment.yaml_document import DocumentNode, KeyPath, component_nodes, dotted
from cairn.errors import CairnError
from cairn.runtime.parameters import FromRobot, field_marks
from cairn.runtime.robot import Robot

ROBOT = "robot"
_PLANE = {"x": 0.0, "y": 0.0, "theta": 0.0}


def with_keys(root: DocumentNode) -> DocumentNode:
    """Return a document in which `robot: NAME` is `robot: {name: NAME}`, for merging."""
    robot = root.entries.get(ROBOT)
    if robot is None or not isinstance(robot.value, str):
        return root
    name = DocumentNode({"name": robot}, robot.at, robot.key_at)
    return DocumentNode({**root.entries, ROBOT: name}, root.at, root.key_at)


def with_robot_defaults(root: DocumentNode) -> tuple[DocumentNode, list[Problem]]:
    """Return the document with the parameters that components have from the robot, and problems."""
    problems: list[Problem] = []
    for use in _uses(root, problems):
        if use.own is None:
            root = _with_value(root, use.path, use.of_robot)
    return root, problems


def contradictions(root: DocumentNode) -> list[Problem]:
    """Return the parameters that differ from the robot's value.

    A parameter may be less than a limit of the robot: that is a component's own limit.
    """
    found = []
    for use in _uses(root, []):
        if use.own is None:
            continue
        own, of_robot = use.own.plain(), use.of_robot.plain()
        if isinstance(own, dict):
            own = _PLANE | own
        if own != of_robot and not (use.quantity.startswith("limits.") and own < of_robot):
            differs = f"{own} differs from {ROBOT}.{use.quantity}, {of_robot} at {use.of_robot.at}"
            remedy = "remove it, or correct one of them"
            found.append(Problem(use.own.where, dotted(use.path), differs, remedy))
    return found


class _SectionUse(NamedTuple):
    """A parameter that has a quantity of the robot by default; `own` is the value it is given."""

    path: KeyPath
    quantity: str
    of_robot: DocumentNode
    own: DocumentNode | None


def _uses(root: DocumentNode, problems: list[Problem]) -> Iterator[_SectionUse]:
    """Yield the parameters of all components, and of fallbacks with plugins of their own."""
    given = root.find(ROBOT) or DocumentNode({}, root.at)
    try:
        robot = Robot.model_validate(given.plain())
    except ValidationError:  # which is reported
        return
    frames = FrameReferences(root.find(FRAMES), root.find(DESCRIPTION))
    for _, path, _ in component_nodes(root):
        for place in (path, (*path, "fallback")):
            plugin = root.find(*place, "plugin")
            if plugin is None:
                continue
            for name, mark in _marks(plugin):
                parameter = (*place, "parameters", name)
                try:
                    value = _value(mark.quantity, given, robot, frames)
                except FrameReferenceError as error:
                    mount = (ROBOT, *mark.quantity.split(".")[:2])
                    at = root.find(*mount)
                    found, _, remedy = str(error).rpartition("; ")
                    problem = (
                        Problem(at.where, dotted(mount), found, remedy)
                        if at
                        else Problem(plugin.where, dotted(parameter), found, remedy)
                    )
                    if root.find(*parameter) is None and problem not in problems:
                        problems.append(problem)
                    continue
                if value is not None:
                    yield _SectionUse(parameter, mark.quantity, value, root.find(*parameter))


def _marks(plugin: DocumentNode) -> list[tuple[str, FromRobot]]:
    try:
        config = load_plugin(str(plugin.value)).config_class()
    except (PluginError, CairnError):  # which is reported
        return []
    return list(field_marks(config, FromRobot))


def _value(
    quantity: str, given: DocumentNode, robot: Robot, frames: FrameReferences
) -> DocumentNode | None:
    """Return a quantity of the robot; None if the deployment does not give it.

    Raises `FrameReferenceError` if a mount that it gives has no pose in the plane.
    """
    if not quantity.startswith("mounts."):
        return given.find(*quantity.split("."))
    _, sensor, *what = quantity.split(".")
    frame, node = getattr(robot.mounts, sensor), given.find("mounts", sensor)
    if what == ["frame"] or (node is None and frame not in frames.names):
        return node
    return frames.value(".".join([frame, *what]), (node or given).at)


def _with_value(root: DocumentNode, path: KeyPath, value: DocumentNode) -> DocumentNode:
    if not path:
        return value
    inner = root.entries.get(path[0], DocumentNode({}, value.at, value.at))
    entries = {**root.entries, path[0]: _with_value(inner, path[1:], value)}
    return DocumentNode(entries, root.at, root.key_at)
