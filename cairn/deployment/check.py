"""Checks a whole deployment in one pass: every problem, each with its line and its remedy."""

from collections.abc import Iterator, Mapping

from cairn.deployment.document import Node, Steps, dotted
from cairn.deployment.model import RESERVED, Deployment
from cairn.deployment.plugins import PluginError, load_plugin
from cairn.deployment.problems import Problem, one_of
from cairn.deployment.tree import Placed, components
from cairn.deployment.validation import invalid
from cairn.deployment.wiring import wiring_problems
from cairn.errors import CairnError
from cairn.runtime.handlers import handlers_of
from cairn.runtime.ports import ports_of


def problems_of(root: Node, unresolved: frozenset[Steps]) -> list[Problem]:
    """All problems of a document whose references are replaced, but for those in `unresolved`."""
    problems = invalid(Deployment, root, (), unresolved)
    placed = []
    first: dict[str, Node] = {}
    for name, path, node in components(root):
        if name in first:
            found = f"the name {name} is used twice, first at {first[name].key_at}"
            at = node.key_at or node.at
            problems.append(Problem(at, dotted(path), found, "give it another name"))
        first.setdefault(name, node)
        if name in RESERVED:
            found = f"{name} is the name of {RESERVED[name]}"
            at = node.key_at or node.at
            problems.append(Problem(at, dotted(path), found, "give it another name"))
        component, found_problems = _resolved(Placed(name, path, node), unresolved)
        placed.append(component)
        problems += found_problems
        problems += _ports_known(component)
        problems += _agreement(component)
    return problems + list(wiring_problems(root, placed))


def _resolved(placed: Placed, unresolved: frozenset[Steps]) -> tuple[Placed, list[Problem]]:
    plugin = placed.node.find("plugin")
    path = (*placed.path, "plugin")
    if plugin is None or not isinstance(plugin.value, str) or path in unresolved:
        return placed, []
    try:
        cls = load_plugin(plugin.value)
    except PluginError as error:
        return placed, [Problem(plugin.where, dotted(path), error.found, error.remedy)]
    try:
        ports, config = ports_of(cls), cls.config_class()
        handlers_of(cls)
    except CairnError as error:
        remedy = "correct the class, or use another plugin"
        return placed, [Problem(plugin.where, dotted(path), str(error), remedy)]
    known = Placed(placed.name, placed.path, placed.node, cls, ports)
    parameters = placed.node.find("parameters") or Node({}, placed.node.where)
    if not isinstance(parameters.value, Mapping):
        return known, []
    return known, invalid(config, parameters, (*placed.path, "parameters"), unresolved)


def _ports_known(placed: Placed) -> Iterator[Problem]:
    topics = placed.node.find("topics")
    if topics is None or placed.ports is None:
        return
    for port, node in topics.entries.items():
        if port not in placed.ports:
            at = node.key_at or node.at
            path = dotted((*placed.path, "topics", port))
            yield Problem(at, path, f"there is no port {port}", one_of(port, placed.ports))


def _agreement(placed: Placed) -> Iterator[Problem]:
    """Keys that are right alone, but cannot work together."""
    name, node = dotted(placed.path), placed.node
    if placed.cls is not None and not placed.cls.is_supervisor:
        for key in ("children", "supervision"):
            given = node.find(key)
            if given is not None and given.entries:
                found = f"{placed.cls.__name__} is not a supervisor"
                remedy = "move it to a supervisor, or remove it"
                yield Problem(given.where, f"{name}.{key}", found, remedy)
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
        found = "a component in its parent's process has its parent's interpreter"
        yield Problem(interpreter.where, f"{name}.interpreter", found, "use placement: process")


def _is(node: Node | None, value: str, default: bool = False) -> bool:
    return default if node is None else node.value == value
