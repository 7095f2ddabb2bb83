"""The ROS names of a robot's topics and services, without the robot's name: `/tf`, `/scan`.

`ros_names: true` gives them to a deployment. The component `ros_names` passes messages and calls on
between both names. A name leads to the robot if nothing in the deployment publishes or serves it.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from cairn.bus.bus import full_name
from cairn.bus.qos import LATCHED, RELIABLE, Qos
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import PluginError, load_plugin
from cairn.runtime.component import Component
from cairn.runtime.ports import ServicePort, actions_of, ports_of, services_of
from cairn.runtime.runtime import STATUS_TOPIC
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.message import Service
from cairn.schemas.rosgraph_msgs import Clock

_LATCHED_OF_ALL = 100
"""Depth of a latched ROS name with several publishers."""


@dataclass(frozen=True)
class RosTopic:
    """A topic with two names.

    Attributes:
        source: name (full) of which the messages are read.
        target: name (full) on which they are published.
        message: class of the messages.
        qos: of both.
        max_bytes: longest message [bytes] that is read; None: the default of the class.
        is_exclusive: whether only the messages of an entitled component are passed on.
    """

    source: str
    target: str
    message: type[Any]
    qos: Qos
    max_bytes: int | None = None
    is_exclusive: bool = False


@dataclass(frozen=True)
class RosService:
    """A service with two names: calls of `name` are passed on to `server`."""

    name: str
    server: str
    service: type[Service[Any, Any]]


@dataclass(frozen=True)
class _Port:
    name: str  # as the deployment has it, without the robot's name
    port: In[Any] | Out[Any]
    is_confidential: bool


def ros_name(name: str) -> str:
    """Return the ROS name of a topic or service that has this short name."""
    return f"/{name}"


def ros_topics(deployment: Deployment) -> list[RosTopic]:
    """Return the topics with two names, in the order of their first port."""
    ports: defaultdict[str, list[_Port]] = defaultdict(list)
    for port in _ports(deployment):
        ports[port.name].append(port)
    external = {_short(deployment, topic) for topic in deployment.external_topics}
    found = []
    for name, uses in ports.items():
        if _keeps_its_name(name, ports) or any(one.is_confidential for one in uses):
            continue
        outputs = [one.port for one in uses if isinstance(one.port, Out)]
        inputs = [one.port for one in uses if isinstance(one.port, In)]
        own, other = full_name(deployment.robot.name, name), ros_name(name)
        is_exclusive = any(one.exclusive for one in inputs)
        if outputs:
            message, qos = outputs[0].interface, outputs[0].qos
            if qos.latched and len(outputs) > 1:
                qos = LATCHED.with_depth(_LATCHED_OF_ALL)
            found.append(RosTopic(own, other, message, qos, None, is_exclusive))
        elif not is_exclusive or name in external:
            latched = any(one.qos.latched for one in inputs)
            depth = max(one.qos.depth for one in inputs)
            qos = (LATCHED if latched else RELIABLE).with_depth(depth)
            longest = [one.max_bytes for one in inputs if one.max_bytes is not None]
            limit = max(longest) if len(longest) == len(inputs) else None
            found.append(RosTopic(other, own, inputs[0].interface, qos, limit))
    if deployment.clock == "simulated" and CLOCK_TOPIC in external - ports.keys():
        own = full_name(deployment.robot.name, CLOCK_TOPIC)
        found.append(RosTopic(ros_name(CLOCK_TOPIC), own, Clock, RELIABLE))
    return found


def ros_services(deployment: Deployment) -> list[RosService]:
    """Return the services with two names, those of actions included."""
    ports: dict[str, ServicePort] = {}
    for name, port in _services(deployment):
        if name not in ports or port.role == "server":
            ports[name] = port
    external = {_short(deployment, name) for name in deployment.external_services}
    found = []
    for name, port in ports.items():
        if _keeps_its_name(name, ports):
            continue
        own, other = full_name(deployment.robot.name, name), ros_name(name)
        if port.role == "server":
            found.append(RosService(other, own, port.interface))
        elif name.partition("/_action/")[0] in external:
            found.append(RosService(own, other, port.interface))
    return found


def _ports(deployment: Deployment) -> Iterator[_Port]:
    for topics, cls in _loadable(deployment):
        for port in ports_of(cls).values():
            name = _short(deployment, topics.get(port.name, port.name))
            yield _Port(name, port, port.name in cls.confidential_inputs)
        for action in actions_of(cls).values():
            name = _short(deployment, topics.get(action.name, action.name))
            for part, topic in action.topics().items():
                yield _Port(f"{name}/{part}", topic, is_confidential=False)


def _services(deployment: Deployment) -> Iterator[tuple[str, ServicePort]]:
    for topics, cls in _loadable(deployment):
        for port in services_of(cls).values():
            yield _short(deployment, topics.get(port.name, port.name)), port
        for action in actions_of(cls).values():
            name = _short(deployment, topics.get(action.name, action.name))
            for part, service in action.services().items():
                yield f"{name}/{part}", service


def _loadable(deployment: Deployment) -> Iterator[tuple[Mapping[str, str], type[Component]]]:
    """Yield topics by port, and class, of each component; the start of another one reports why."""
    for member in deployment.members():
        with suppress(PluginError):
            yield member.spec.topics, load_plugin(member.spec.plugin)


def _keeps_its_name(name: str, known: Mapping[str, Any]) -> bool:
    """Return whether a name is complete, or its ROS name is used in the deployment already.

    Every component publishes its status, also where none of the ports says so.
    """
    return name.startswith("/") or ros_name(name) in known or name == STATUS_TOPIC


def _short(deployment: Deployment, name: str) -> str:
    return name.removeprefix(f"/{deployment.robot.name}/")
