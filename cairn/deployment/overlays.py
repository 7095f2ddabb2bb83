"""Changes laid over a deployment: further files, and `--set path=value`.

Mappings are merged key by key, everything else is replaced, null removes a key (RFC 7386); among
the settings it is a value, as nobody could use a setting that is not there.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

from cairn.deployment.document import Node, Steps, dotted, parse
from cairn.deployment.problems import Location, Problem, one_of
from cairn.deployment.tree import components


def overlaid(base: Node, over: Node) -> tuple[Node, list[Problem]]:
    """The base with an overlay on it; places follow the file that each value comes from."""
    problems: list[Problem] = []
    return _merged(base, over, (), problems), problems


def _merged(base: Node, over: Node, path: Steps, problems: list[Problem]) -> Node:
    if not isinstance(over.value, Mapping):
        return over
    merged = isinstance(base.value, Mapping)
    entries = dict(base.entries)
    for key, node in over.value.items():
        steps = (*path, key)
        if node.value is None and path[:1] == ("settings",):
            entries[key] = node
        elif node.value is not None:
            nothing = Node({}, node.at, node.key_at)
            entries[key] = _merged(entries.get(key, nothing), node, steps, problems)
        elif entries.pop(key, None) is None:
            remedy = one_of(key, base.entries) if base.entries else "remove the line"
            problems.append(
                Problem(node.where, dotted(steps), "null removes a key, and there is none", remedy)
            )
    return Node(entries, base.at, base.key_at) if merged else Node(entries, over.at, over.key_at)


def assigned(base: Node, assignment: str, sections: frozenset[str]) -> tuple[Node, list[Problem]]:
    """The base with one `--set` laid over it: `path=value`, the value in YAML.

    A path whose first key is not one of the format's `sections` names a setting, which must exist;
    `components.NAME` finds the component at any depth of the tree.
    """
    at = Location(f"--set {assignment}", 0, 0, Path.cwd())
    path, equals, text = assignment.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys):
        remedy = "write key.path=value, as in recording.rate=10"
        return base, [Problem(at, "", f"{assignment!r} is not an assignment", remedy)]
    if not text.strip():
        remedy = "give one, or null to remove the key"
        return base, [Problem(at, "", "there is no value after the =", remedy)]
    value, problems = parse(text, at)
    if value is None or problems:
        return base, problems
    steps, problem = _target(base, keys, at, sections)
    if problem is not None:
        return base, [problem]
    return overlaid(base, _nested(steps, value, at))


def _target(
    base: Node, keys: list[str], at: Location, sections: frozenset[str]
) -> tuple[Steps, Problem | None]:
    if keys[0] == "components" and len(keys) > 1:
        places = {name: path for name, path, _ in components(base)}
        if keys[1] not in places:
            found = f"there is no component {keys[1]}"
            return (), Problem(at, ".".join(keys[:2]), found, one_of(keys[1], places))
        return (*places[keys[1]], *keys[2:]), None
    if keys[0] in sections and keys[0] != "settings":
        return tuple(keys), None
    names = keys[1:] if keys[0] == "settings" else keys
    if base.find("settings", *names) is None:
        known = [".".join(steps) for steps in _settings(base.find("settings"), ())]
        found = f"there is no setting {'.'.join(names)}"
        return (), Problem(at, "", found, one_of(".".join(names), known))
    return ("settings", *names), None


def _settings(node: Node | None, path: Steps) -> Iterator[Steps]:
    if node is None:
        return
    for key, child in node.entries.items():
        yield (*path, key)
        yield from _settings(child, (*path, key))


def _nested(steps: Steps, value: Node, at: Location) -> Node:
    node = Node(value.value, at, at)
    for step in reversed(steps):
        node = Node({step: node}, at, at)
    return node
