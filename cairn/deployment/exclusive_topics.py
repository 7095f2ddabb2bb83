"""Exclusive topics of a deployment: which component may publish on each, and which ones read it."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any

from cairn.bus.bus import full_name
from cairn.bus.exclusive import ExclusiveTopic
from cairn.bus.keys import ROS_NAMES
from cairn.deployment.model import Deployment, Member
from cairn.deployment.plugins import PluginError, load_plugin
from cairn.errors import CairnError
from cairn.runtime.ports import ports_of
from cairn.runtime.topic_ports import In, Out


def exclusive_topics(deployment: Deployment) -> tuple[ExclusiveTopic, ...]:
    """Return the exclusive topics of a deployment that `cairn check` accepts, sorted by name.

    Raises `CairnError` if an exclusive topic has two writers. A component whose plugin cannot be
    loaded is left out, and so neither entitled nor able to read: its own start reports why.
    """
    writers: defaultdict[str, list[str]] = defaultdict(list)
    readers: defaultdict[str, list[str]] = defaultdict(list)
    for member, topic, port in ports_in(deployment):
        if port.direction == "out":
            writers[topic].append(member.name)
        elif port.exclusive:
            readers[topic].append(member.name)
    if deployment.ros_names:  # it passes on what the entitled component has published
        for names in readers.values():
            names.append(ROS_NAMES)
    external = {full_name(deployment.robot.name, topic) for topic in deployment.external_topics}
    found = []
    for topic in sorted(readers):
        names = sorted(set(writers[topic]))
        if len(names) > 1:
            raise CairnError(f"{two_writers(topic, names, readers[topic][0])}; {ONE_WRITER}")
        machines = {deployment.machine_of(name) for name in (*names, *readers[topic])}
        found.append(
            ExclusiveTopic(
                topic=topic,
                writer=names[0] if names else "",
                readers=tuple(readers[topic]),
                external=not names and topic in external,
                several_machines=len(machines) > 1,
            )
        )
    return tuple(found)


ONE_WRITER = "give all but one of them another topic, or put a component between them and the topic"
"""The remedy for two writers."""


def two_writers(topic: str, writers: Iterable[str], reader: str) -> str:
    """Return the description of the problem that an exclusive topic has several writers."""
    return (
        f"topic {topic} has several writers, {' and '.join(writers)}, but {reader} reads it "
        "exclusively: it accepts the messages of one component"
    )


def only_writer(topic: str, writers: Iterable[str], writer: str) -> str:
    """Return the description of the problem that an exclusive writer is not the only one."""
    return (
        f"topic {topic} has several writers, {' and '.join(writers)}, but {writer} must be the "
        "only one"
    )


def ports_in(deployment: Deployment) -> Iterator[tuple[Member, str, In[Any] | Out[Any]]]:
    """Yield the component, topic and declaration of each port whose plugin can be loaded."""
    for member in deployment.members():
        with suppress(PluginError):
            for port in ports_of(load_plugin(member.spec.plugin)).values():
                topic = member.spec.topics.get(port.name, port.name)
                yield member, full_name(deployment.robot.name, topic), port
