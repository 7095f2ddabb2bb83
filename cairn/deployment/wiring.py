"""Checks who reads and writes which topic: types agree, and every input has a writer."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from cairn.deployment.document import Node, dotted
from cairn.deployment.problems import Problem, one_of
from cairn.deployment.tree import Placed
from cairn.runtime.ports import PortSpec
from cairn.schemas.message import type_name

_CLOCK = "clock"
_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"


@dataclass(frozen=True)
class _End:
    """One port of one component on a topic."""

    placed: Placed
    port: PortSpec

    def problem(self, found: str, remedy: str) -> Problem:
        path = dotted((*self.placed.path, "topics", self.port.name))
        return Problem(self.placed.line(self.port.name), path, found, remedy)


def wiring_problems(root: Node, placed: list[Placed]) -> Iterator[Problem]:
    """Topics with two types, inputs that nobody writes, and a simulated clock without a writer."""
    robot = root.find("robot")
    own = f"/{robot.value if robot is not None else 'robot'}/"
    topics: defaultdict[str, list[_End]] = defaultdict(list)
    for component in placed:
        for port in (component.ports or {}).values():
            topics[component.topic(port.name).removeprefix(own)].append(_End(component, port))
    external = {topic.removeprefix(own) for topic in _texts(root.find("external_topics"))}
    written = external | {
        topic for topic, ends in topics.items() if any(end.port.direction == "out" for end in ends)
    }
    complete = all(component.ports is not None for component in placed)
    for topic, ends in topics.items():
        yield from _types(topic, ends)
        if topic not in written:
            yield from _unwritten(topic, ends, written, complete)
    yield from _devices(root, placed)
    yield from _clock(root, topics[_CLOCK], _CLOCK in external)


def _types(topic: str, ends: list[_End]) -> Iterator[Problem]:
    ends = sorted(ends, key=lambda end: end.port.direction == "in")
    first = ends[0]
    expected = type_name(first.port.message)
    verbs = {"in": "reads", "out": "writes"}
    for end in ends[1:]:
        if type_name(end.port.message) != expected:
            yield end.problem(
                f"topic {topic} has two types: {end.port.name} {verbs[end.port.direction]} "
                f"{type_name(end.port.message)}, but {first.placed.name}.{first.port.name} "
                f"{verbs[first.port.direction]} {expected}",
                "give one of them another topic",
            )


def _unwritten(
    topic: str, ends: list[_End], written: set[str], complete: bool
) -> Iterator[Problem]:
    unknown = "" if complete else " (a plugin that could not be loaded may write it)"
    remedy = "add its writer, correct the topic, or list it under external_topics"
    close = one_of(topic, written)
    for end in ends:
        if not end.port.optional:
            yield end.problem(
                f"nobody writes topic {topic}, which input {end.port.name} needs{unknown}",
                f"{remedy}; {close}" if close.startswith("did you mean") else remedy,
            )


def _clock(root: Node, ends: list[_End], external: bool) -> Iterator[Problem]:
    clock = root.find("clock")
    if clock is None or clock.value != "simulated" or external:
        return
    writers = [
        end
        for end in ends
        if end.port.direction == "out" and type_name(end.port.message) == _CLOCK_TYPE
    ]
    if not writers:
        yield Problem(
            clock.where,
            "clock",
            f"the clock is simulated, but no component writes {_CLOCK_TYPE} on topic {_CLOCK}",
            f"add one that does, list {_CLOCK} under external_topics, or use clock: system",
        )
    for writer in writers:
        if writer.placed.cls is not None and writer.placed.cls.clock_source != "system":
            yield writer.problem(
                f"{writer.placed.cls.__name__} makes the simulated clock, but waits for it itself",
                'give the class `clock_source = "system"`',
            )


def _devices(root: Node, placed: list[Placed]) -> Iterator[Problem]:
    clock = root.find("clock")
    if clock is None or clock.value != "simulated":
        return
    for one in placed:
        plugin = one.node.find("plugin")
        if plugin is not None and one.cls is not None and one.cls.clock_source == "device":
            yield Problem(
                plugin.where,
                dotted((*one.path, "plugin")),
                f"{one.cls.__name__} drives a device, which cannot follow simulated time",
                "use clock: system, or put a simulated or replayed driver in its place",
            )


def _texts(node: Node | None) -> list[str]:
    items = node.value if node is not None and isinstance(node.value, tuple) else ()
    return [item.value for item in items if isinstance(item.value, str)]
