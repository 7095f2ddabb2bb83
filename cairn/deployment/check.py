"""Check a whole deployment in one pass: every problem, each with its line and its remedy.

The sections and the parameters of each plugin are validated by `cairn.deployment.validation`; here
are the rules between them: unique names, ports and topics, message types, clocks, and what the
components' own classes require of their neighbors.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import ValidationError

from cairn.bus.keys import ROS_NAMES
from cairn.deployment.bus_settings import BusSettings
from cairn.deployment.exclusive_topics import ONE_WRITER, only_writer, two_writers
from cairn.deployment.frames import DESCRIPTION, FRAMES, FrameReferences
from cairn.deployment.machines import machine_problems
from cairn.deployment.model import RESERVED, ROBOT_FRAMES, Deployment, fallback_name
from cairn.deployment.plugins import PluginError, find_plugin, load_plugin
from cairn.deployment.problems import Location, Problem, suggestion
from cairn.deployment.validation import validation_problems
from cairn.deployment.yaml_document import DocumentNode, KeyPath, component_nodes, dotted
from cairn.errors import CairnError
from cairn.runtime.handlers import handlers_of
from cairn.runtime.parameters import Config, SensorFrameMark, marked_parameters
from cairn.runtime.ports import (
    ActionPort,
    ServicePort,
    actions_of,
    ports_of,
    services_of,
)
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.message import type_name

if TYPE_CHECKING:
    from cairn.runtime.component import Component


@dataclass(frozen=True)
class CheckedComponent:
    """A component of the document with its plugin's class, ports and parameters.

    These are None if they are unknown, the parameters also if they are invalid.
    """

    name: str
    path: KeyPath
    node: DocumentNode
    cls: "type[Component] | None" = None
    ports: "dict[str, In[Any] | Out[Any]] | None" = None
    services: "dict[str, ServicePort | ActionPort]" = field(default_factory=dict)
    config: Config | None = None

    def topic(self, port: str) -> str:
        """Return the topic that the document gives to the port."""
        node = self.node.find("topics", port)
        return node.value if node is not None and isinstance(node.value, str) else port

    def line(self, port: str) -> Location:
        """Return the location of the port's topic, else that of the plugin."""
        node = self.node.find("topics", port) or self.node.find("plugin") or self.node
        return node.where


def check_document(
    root: DocumentNode, unresolved: frozenset[KeyPath], *, import_plugins: bool = True
) -> list[Problem]:
    """Return all problems of a document with replaced references, except at `unresolved` paths.

    Without `import_plugins`, no code that the document names is run: plugins are only looked up in
    the metadata of the installed packages, so parameters, ports, topics and files are not checked.
    """
    problems = validation_problems(Deployment, root, (), unresolved)
    components: list[CheckedComponent] = []
    first: dict[str, DocumentNode] = {}
    for name, path, node in component_nodes(root):
        if name in first:
            found = f"the name {name} is used twice, first at {first[name].key_at}"
            at = node.key_at or node.at
            problems.append(Problem(at, dotted(path), found, "give it another name"))
        first.setdefault(name, node)
        if name in RESERVED:
            found = f"{name} is the name of {RESERVED[name]}"
            at = node.key_at or node.at
            problems.append(Problem(at, dotted(path), found, "give it another name"))
        component, plugin_problems = _resolve_plugin(
            CheckedComponent(name, path, node), unresolved, import_plugins=import_plugins
        )
        components.append(component)
        problems += plugin_problems
        problems += _unknown_ports(component)
        problems += _unwatchable_ages(component)
        problems += _conflicting_keys(component)
        problems += _unattainable_stop(root, component)
    problems += machine_problems(root)
    if not import_plugins:
        return problems
    components += _implicit_components(root)
    for fallback, fallback_problems in _fallbacks(components, unresolved):
        components.append(fallback)
        problems += fallback_problems
    problems += _file_problems(root)
    problems += _frame_problems(root, components)
    return problems + list(_wiring_problems(root, components))


def _implicit_components(root: DocumentNode) -> Iterator[CheckedComponent]:
    """Yield the components that keys of the document add, which it does not name."""
    for plugin, keys in ((ROBOT_FRAMES, (FRAMES, DESCRIPTION)), (ROS_NAMES, (ROS_NAMES,))):
        section = next((node for key in keys if (node := root.find(key)) is not None), None)
        if section is not None and section.value:
            node = DocumentNode({"plugin": DocumentNode(plugin, section.where)}, section.where)
            own = CheckedComponent(plugin, ("components", plugin), node)
            yield _resolve_plugin(own, frozenset(), import_plugins=True)[0]


def _fallbacks(
    components: list[CheckedComponent], unresolved: frozenset[KeyPath]
) -> list[tuple[CheckedComponent, list[Problem]]]:
    """Return the fallbacks of components with their problems.

    Their services are left out: a fallback serves only while its component does not.
    """
    names = {component.name for component in components}
    found = []
    for component in components:
        section = component.node.find("fallback")
        if section is None or not section.entries:
            continue
        name, path = fallback_name(component.name), (*component.path, "fallback")
        plugin = section.find("plugin") or component.node.find("plugin")
        inherited = component.node.find("parameters") if section.find("plugin") is None else None
        keys = {
            "plugin": plugin,
            "parameters": _merged(inherited, section.find("parameters")),
            "topics": component.node.find("topics"),
        }
        entries = {key: node for key, node in keys.items() if node is not None}
        node = DocumentNode(entries, section.at, section.key_at)
        resolved, problems = _resolve_plugin(
            CheckedComponent(name, path, node), unresolved, import_plugins=True
        )
        if name in names:
            text = f"the name {name} is used twice: it is also that of a component"
            problems.append(Problem(section.where, dotted(path), text, "rename that component"))
        found.append((replace(resolved, services={}), problems))
    return found


def _merged(own: DocumentNode | None, other: DocumentNode | None) -> DocumentNode | None:
    """Return the parameters of a component with those of its fallback in their place."""
    if own is None or other is None:
        return own or other
    return DocumentNode({**own.entries, **other.entries}, other.at, other.key_at)


def _frame_problems(root: DocumentNode, components: list[CheckedComponent]) -> Iterator[Problem]:
    """Yield frames that two components publish, and those of sensors that the robot has not."""
    frames, description = root.find(FRAMES), root.find(DESCRIPTION)
    if frames is None and description is None:
        return
    found = FrameReferences(frames, description)
    if found.problems:
        return
    for component in components:
        plugin = component.node.find("plugin") or component.node
        published = frozenset() if component.cls is None else component.cls.published_frames
        for name in sorted(published & {*found.names}):
            where = FRAMES if frames is not None and name in frames.entries else DESCRIPTION
            yield Problem(
                plugin.where,
                dotted((*component.path, "plugin")),
                f"it publishes the transform of frame {name}, which {where} has, too",
                f"remove {name} from {where}",
            )
        if component.config is None or "tf_static" in _texts(root.find("external_topics")):
            continue
        for parameter in marked_parameters(component.config, SensorFrameMark):
            if parameter.value not in found.names:
                path = (*component.path, "parameters", parameter.name)
                node = component.node.find("parameters", *parameter.name.split(".")) or plugin
                yield Problem(
                    node.where,
                    dotted(path),
                    f"there is no frame {parameter.value} on the robot",
                    f"add it below {FRAMES}, name another one of {', '.join(found.names)}, or list "
                    "tf_static under external_topics",
                )


def _file_problems(root: DocumentNode) -> Iterator[Problem]:
    """Yield the secrets, certificates and folders that cannot be used.

    Those values of `bus` that are invalid are reported otherwise.
    """
    bus = root.find("bus")
    values = bus.plain() if bus is not None else None
    if bus is None or not isinstance(values, dict):
        return
    for key, reason in BusSettings.valid_part(values).file_problems():
        node = bus.find(*key) or bus
        found, _, remedy = reason.rpartition("; ")
        yield Problem(node.where, dotted(("bus", *key)), found or reason, remedy)


def _resolve_plugin(
    component: CheckedComponent, unresolved: frozenset[KeyPath], *, import_plugins: bool
) -> tuple[CheckedComponent, list[Problem]]:
    plugin = component.node.find("plugin")
    path = (*component.path, "plugin")
    if plugin is None or not isinstance(plugin.value, str) or path in unresolved:
        return component, []
    try:
        if not import_plugins:
            find_plugin(plugin.value)
            return component, []
        cls = load_plugin(plugin.value)
    except PluginError as error:
        return component, [Problem(plugin.where, dotted(path), error.found, error.remedy)]
    try:
        ports, config = ports_of(cls), cls.config_class()
        services: dict[str, ServicePort | ActionPort] = {**services_of(cls), **actions_of(cls)}
        handlers_of(cls)
        if unknown := sorted(cls.service_roles.keys() - services.keys()):
            raise CairnError(f"{cls.__name__}.service_roles names unknown ports: {unknown}")
        for attribute in ("operator_inputs", "confidential_inputs"):
            if unknown := sorted(getattr(cls, attribute) - ports.keys()):
                raise CairnError(f"{cls.__name__}.{attribute} names unknown ports: {unknown}")
    except CairnError as error:
        remedy = "correct the class, or use another plugin"
        return component, [Problem(plugin.where, dotted(path), str(error), remedy)]
    known = replace(component, cls=cls, ports=ports, services=services)
    parameters = component.node.find("parameters") or DocumentNode({}, component.node.where)
    if not isinstance(parameters.value, Mapping):
        return known, []
    problems = validation_problems(config, parameters, (*component.path, "parameters"), unresolved)
    if not problems:
        with suppress(ValidationError):  # of references that are reported already
            known = replace(known, config=config.model_validate(parameters.plain()))
    return known, problems


def _unknown_ports(component: CheckedComponent) -> Iterator[Problem]:
    topics = component.node.find("topics")
    if topics is None or component.ports is None:
        return
    known = {*component.ports, *component.services}
    for port, node in topics.entries.items():
        if port not in known:
            at = node.key_at or node.at
            path = dotted((*component.path, "topics", port))
            yield Problem(at, path, f"there is no port {port}", suggestion(port, known))


def _unwatchable_ages(component: CheckedComponent) -> Iterator[Problem]:
    """Yield ages that are given for something else than inputs whose messages become old."""
    ages = component.node.find("max_age_s")
    if ages is None or component.ports is None:
        return
    inputs = {name for name, one in component.ports.items() if one.direction == "in"}
    for port, node in ages.entries.items():
        at, path = node.key_at or node.at, dotted((*component.path, "max_age_s", port))
        if port not in inputs:
            yield Problem(at, path, f"there is no input {port}", suggestion(port, inputs))
        elif component.ports[port].qos.latched:
            found = "its topic is latched: the last message stays valid, however old it is"
            yield Problem(at, path, found, "remove it")


def _conflicting_keys(component: CheckedComponent) -> Iterator[Problem]:
    """Yield problems of keys that are valid alone but not together."""
    name, node = dotted(component.path), component.node
    if component.cls is not None and not component.cls.is_supervisor:
        for key in ("children", "supervision"):
            section = node.find(key)
            if section is not None and section.entries:
                found = f"{component.cls.__name__} is not a supervisor"
                remedy = "move it to a supervisor, or remove it"
                yield Problem(section.where, f"{name}.{key}", found, remedy)
    significant = node.find("significant")
    restart = node.find("restart")
    if significant is not None and significant.value is True and _is(restart, "permanent", True):
        found = "a permanent component is restarted when it ends, so it cannot end the deployment"
        remedy = "add `restart: transient` or `restart: temporary`"
        yield Problem(significant.where, f"{name}.significant", found, remedy)
    interpreter = node.find("interpreter")
    if (
        interpreter is not None
        and _is(interpreter, "fresh")
        and _is(node.find("placement"), "in_process")
    ):
        found = "a component in its parent's process uses its parent's interpreter"
        yield Problem(interpreter.where, f"{name}.interpreter", found, "use placement: process")
    memory = node.find("memory_max_mib")
    if memory is not None and _is(node.find("placement"), "in_process"):
        found = "the memory of a component in its parent's process is its parent's"
        remedy = "set it for the parent, or use placement: process"
        yield Problem(memory.where, f"{name}.memory_max_mib", found, remedy)


def _unattainable_stop(root: DocumentNode, component: CheckedComponent) -> Iterator[Problem]:
    """Yield a component's time limit for stopping if the deployment's does not allow it."""
    own, whole = component.node.find("stop_timeout_s"), root.find("stop_limit_s")
    if own is None:
        return
    own_s = own.value
    limit_s = Deployment.model_fields["stop_limit_s"].default if whole is None else whole.value
    if isinstance(own_s, int | float) and isinstance(limit_s, int | float) and own_s >= limit_s:
        found = f"{own_s:g} s are not less than the deployment's stop_limit_s, {limit_s:g} s"
        path = dotted((*component.path, "stop_timeout_s"))
        yield Problem(own.where, path, found, "decrease it, or increase stop_limit_s")


def _is(node: DocumentNode | None, value: str, default: bool = False) -> bool:
    return default if node is None else node.value == value


P = TypeVar("P", In[Any] | Out[Any], ServicePort | ActionPort)

_CLOCK = "clock"
_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"


@dataclass(frozen=True)
class _Use(Generic[P]):
    """A port of one component on a topic, or its server or client of a service or an action."""

    component: CheckedComponent
    port: P

    @property
    def type_name(self) -> str:
        """The type of the messages, the service or the action."""
        return type_name(self.port.interface)

    def problem(self, found: str, remedy: str) -> Problem:
        path = dotted((*self.component.path, "topics", self.port.name))
        return Problem(self.component.line(self.port.name), path, found, remedy)


_PortUse = _Use[In[Any] | Out[Any]]
_ServiceUse = _Use[ServicePort | ActionPort]


def _wiring_problems(root: DocumentNode, components: list[CheckedComponent]) -> Iterator[Problem]:
    """Yield conflicts of types and of writers, inputs without a publisher, clock conflicts."""
    robot = root.find("robot", "name")
    own = f"/{robot.value if robot is not None else 'robot'}/"
    topics: defaultdict[str, list[_PortUse]] = defaultdict(list)
    for component in components:
        for port in (component.ports or {}).values():
            topics[component.topic(port.name).removeprefix(own)].append(_PortUse(component, port))
    external = {topic.removeprefix(own) for topic in _texts(root.find("external_topics"))}
    written = external | {
        topic for topic, uses in topics.items() if any(use.port.direction == "out" for use in uses)
    }
    complete = all(component.ports is not None for component in components)
    for topic, uses in topics.items():
        yield from _type_conflicts(topic, uses)
        yield from _exclusive_conflicts(topic, uses)
        if topic not in written:
            yield from _missing_publishers(topic, uses, written, complete)
    yield from _service_problems(root, components, own, complete=complete)
    yield from _neighbor_problems(topics, external)
    yield from _device_problems(root, components)
    yield from _clock_problems(root, topics[_CLOCK], _CLOCK in external)


def _service_problems(
    root: DocumentNode, components: list[CheckedComponent], own: str, *, complete: bool
) -> Iterator[Problem]:
    """Yield services with two types or two servers, and clients without a server."""
    services: defaultdict[str, list[_ServiceUse]] = defaultdict(list)
    for component in components:
        for port in component.services.values():
            name = component.topic(port.name).removeprefix(own)
            services[name].append(_ServiceUse(component, port))
    external = {name.removeprefix(own) for name in _texts(root.find("external_services"))}
    served = external | {
        name for name, uses in services.items() if any(use.port.role == "server" for use in uses)
    }
    for name, uses in services.items():
        uses = sorted(uses, key=lambda use: use.port.role, reverse=True)
        for use in uses[1:]:
            first = uses[0]
            if use.type_name != first.type_name:
                yield use.problem(
                    f"service {name} has two types: {use.type_name} here, {first.type_name} in "
                    f"{first.component.name}.{first.port.name}",
                    "give one of them another name",
                )
            elif use.port.role == "server":
                yield use.problem(
                    f"service {name} has two servers: {first.component.name} is one already",
                    "give one of them another name",
                )
        if name not in served:
            unknown = "" if complete else " (a plugin that could not be loaded may provide it)"
            remedy = "add its server, correct the name, or list it under external_services"
            close = suggestion(name, served)
            for use in uses:
                if use.port.role == "client" and not use.port.optional:
                    yield use.problem(
                        f"no component provides service {name}, which client {use.port.name} "
                        f"needs{unknown}",
                        f"{remedy}; {close}" if close.startswith("did you mean") else remedy,
                    )


def _type_conflicts(topic: str, uses: list[_PortUse]) -> Iterator[Problem]:
    uses = sorted(uses, key=lambda use: use.port.direction == "in")
    first = uses[0]
    verbs = {"in": "reads", "out": "publishes"}
    for use in uses[1:]:
        if use.type_name != first.type_name:
            yield use.problem(
                f"topic {topic} has two types: {use.port.name} {verbs[use.port.direction]} "
                f"{use.type_name}, but {first.component.name}.{first.port.name} "
                f"{verbs[first.port.direction]} {first.type_name}",
                "give one of them another topic",
            )


def _exclusive_conflicts(topic: str, uses: list[_PortUse]) -> Iterator[Problem]:
    writers = {use.component.name: use for use in uses if use.port.direction == "out"}
    exclusive = sorted(
        (use for use in uses if use.port.exclusive), key=lambda use: use.port.direction
    )
    if exclusive and len(writers) > 1:
        first, last = exclusive[0], list(writers.values())[-1]
        name = first.component.name
        found = (
            two_writers(topic, writers, name)
            if first.port.direction == "in"
            else only_writer(topic, writers, name)
        )
        yield last.problem(found, ONE_WRITER)


def _neighbor_problems(
    topics: Mapping[str, list[_PortUse]], external: set[str]
) -> Iterator[Problem]:
    """Yield what the components' classes find wrong with the parameters of their neighbors."""
    found: dict[str, CheckedComponent] = {}
    neighbors: defaultdict[str, dict[str, dict[str, Config]]] = defaultdict(dict)
    for topic, uses in topics.items():
        outside = {"external_topics": Config()} if topic in external else {}
        for use in uses:
            found[use.component.name] = use.component
            neighbors[use.component.name][use.port.name] = outside | {
                other.component.name: other.component.config or Config()
                for other in uses
                if other.port.direction != use.port.direction
            }
    for name, component in found.items():
        if component.cls is None or component.config is None:
            continue
        for key, reason, remedy in component.cls.check_neighbors(component.config, neighbors[name]):
            node = (
                component.node.find("parameters", *key.split("."))
                or component.node.find("plugin")
                or component.node
            )
            path = dotted((*component.path, "parameters", key))
            yield Problem(node.where, path, reason, remedy)


def _missing_publishers(
    topic: str, uses: list[_PortUse], written: set[str], complete: bool
) -> Iterator[Problem]:
    unknown = "" if complete else " (a plugin that could not be loaded may publish it)"
    remedy = "add its publisher, correct the topic, or list it under external_topics"
    close = suggestion(topic, written)
    for use in uses:
        if use.port.direction == "in" and not use.port.optional:
            yield use.problem(
                f"no component publishes topic {topic}, which input {use.port.name} needs{unknown}",
                f"{remedy}; {close}" if close.startswith("did you mean") else remedy,
            )


def _clock_problems(root: DocumentNode, uses: list[_PortUse], external: bool) -> Iterator[Problem]:
    clock = root.find("clock")
    if clock is None or clock.value != "simulated" or external:
        return
    writers = [use for use in uses if use.port.direction == "out" and use.type_name == _CLOCK_TYPE]
    if not writers:
        yield Problem(
            clock.where,
            "clock",
            f"the clock is simulated, but no component publishes {_CLOCK_TYPE} on topic {_CLOCK}",
            f"add one that does, list {_CLOCK} under external_topics, or use clock: system",
        )
    for writer in writers:
        if writer.component.cls is not None and writer.component.cls.clock_source != "system":
            yield writer.problem(
                f"{writer.component.cls.__name__} publishes the simulated clock but uses it itself",
                'give the class `clock_source = "system"`',
            )


def _device_problems(root: DocumentNode, components: list[CheckedComponent]) -> Iterator[Problem]:
    clock = root.find("clock")
    if clock is None or clock.value != "simulated":
        return
    for component in components:
        plugin = component.node.find("plugin")
        if (
            plugin is not None
            and component.cls is not None
            and component.cls.clock_source == "device"
        ):
            yield Problem(
                plugin.where,
                dotted((*component.path, "plugin")),
                f"{component.cls.__name__} drives a device, which cannot follow simulated time",
                "use clock: system, or put a simulated or replayed driver in its place",
            )


def _texts(node: DocumentNode | None) -> list[str]:
    items = node.value if node is not None and isinstance(node.value, tuple) else ()
    return [item.value for item in items if isinstance(item.value, str)]
