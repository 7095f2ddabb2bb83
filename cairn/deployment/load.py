"""Load a deployment: a file with overlays and `--set`s, its settings replaced, then checked.

Overlays and `--set path=value` change the document. Mappings are merged key by key, everything else
is replaced, null removes a key (RFC 7386). Among the settings null is a value, because a setting
that does not exist could not be referred to.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from cairn.bus.endpoints import default_domain
from cairn.deployment.check import check_document
from cairn.deployment.frames import FRAMES
from cairn.deployment.interpolation import interpolate
from cairn.deployment.model import Deployment
from cairn.deployment.problems import DeploymentError, Location, Problem, suggestion
from cairn.deployment.robot_defaults import contradictions, with_keys, with_robot_defaults
from cairn.deployment.yaml_document import (
    DocumentNode,
    KeyPath,
    component_nodes,
    dotted,
    parse_document,
    read_document,
)
from cairn.limits.yaml import YAML_VALUES
from cairn.runtime.robot import Robot

_SECTIONS = frozenset(Deployment.model_fields)


def load_deployment(
    file: Path,
    overlays: Sequence[Path] = (),
    sets: Sequence[str] = (),
    *,
    import_plugins: bool = True,
) -> Deployment:
    """Return the deployment in a file, changed by overlays and `path=value` assignments in order.

    Without `import_plugins`, code that the deployment names is not run, and what only that code
    knows is not checked: parameters, ports and topics. Raises `DeploymentError` with all problems;
    only with those of the syntax if a file cannot be read.
    """
    return assemble(read_sources(file, overlays), sets, import_plugins=import_plugins)


class DeploymentNames(NamedTuple):
    """The names by which a deployment is reached on the bus; `components` at any depth."""

    robot: str
    domain: int
    components: tuple[str, ...]


def read_names(
    file: Path, overlays: Sequence[Path] = (), sets: Sequence[str] = ()
) -> DeploymentNames:
    """Return the names in a deployment without checking the rest, and without importing plugins.

    Raises `DeploymentError` if a file cannot be read, an assignment is invalid, or a reference to
    a setting cannot be replaced.
    """
    merged, problems = _merge_sources(read_sources(file, overlays), sets)
    root, found, _ = interpolate(merged)
    problems += found
    if problems:
        raise DeploymentError(problems)
    robot, domain = root.find("robot", "name"), root.find("domain")
    return DeploymentNames(
        Robot.model_fields["name"].default if robot is None else str(robot.value),
        domain.value if domain is not None and isinstance(domain.value, int) else default_domain(),
        tuple(name for name, _, _ in component_nodes(root)),
    )


class SourceDocument(NamedTuple):
    """A file that was read: its tree, None if it is unreadable, and its problems."""

    file: Path
    node: DocumentNode | None
    problems: list[Problem]


def read_sources(file: Path, overlays: Sequence[Path] = ()) -> list[SourceDocument]:
    """Read a deployment's file and its overlays, each once, because one may be a pipe."""
    return [SourceDocument(one, *read_document(one)) for one in (file, *overlays)]


def assemble(
    sources: Sequence[SourceDocument], sets: Sequence[str] = (), *, import_plugins: bool = True
) -> Deployment:
    """Return the deployment in files that were read before, as `load_deployment` does."""
    root, problems = _merge_sources(sources, sets)
    root, found, unresolved = interpolate(root)
    problems += found
    if _exceeds(root, YAML_VALUES):
        found_too_much = f"with its settings the deployment holds more than {YAML_VALUES:,} values"
        raise DeploymentError([*problems, Problem(root.at, "", found_too_much, "write fewer")])
    if import_plugins:
        root, found = with_robot_defaults(root)
        problems += found
    reported = {(problem.path, problem.at.line) for problem in problems}
    checked = check_document(root, unresolved, import_plugins=import_plugins)
    problems += [one for one in checked if (one.path, one.at.line) not in reported]
    if problems:
        origins = [str(source.file) for source in sources]
        raise DeploymentError(sorted(problems, key=lambda problem: _order(problem, origins)))
    return Deployment.model_validate(root.plain())


def contradictions_of(sources: Sequence[SourceDocument], sets: Sequence[str] = ()) -> list[Problem]:
    """Return where parameters contradict the robot, in files with a valid deployment."""
    root, _ = _merge_sources(sources, sets)
    return contradictions(interpolate(root)[0])


def merge(sources: Sequence[SourceDocument], sets: Sequence[str] = ()) -> DocumentNode:
    """Return files that were read before as one tree, changed by overlays and assignments.

    References to settings stay as they are written. Raises `DeploymentError` with all problems.
    """
    root, problems = _merge_sources(sources, sets)
    if problems:
        raise DeploymentError(problems)
    return root


def apply_overlay(base: DocumentNode, over: DocumentNode) -> tuple[DocumentNode, list[Problem]]:
    """Return the base changed by an overlay, and problems; locations are those of the values."""
    problems: list[Problem] = []
    return _merged(with_keys(base), with_keys(over), (), problems), problems


def apply_set(
    base: DocumentNode, assignment: str, sections: frozenset[str]
) -> tuple[DocumentNode, list[Problem]]:
    """Return the base changed by one `--set`, `path=value` with the value in YAML, and problems.

    A path whose first key is not one of the format's `sections` names a setting, which must exist,
    as must the frame of `frames.NAME.x`; `components.NAME` finds the component at any depth of the
    tree.
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
    value, problems = parse_document(text, at)
    if value is None or problems:
        return base, problems
    steps, problem = _target(base, keys, at, sections)
    if problem is not None:
        return base, [problem]
    return apply_overlay(base, _nested(steps, value, at))


def _merge_sources(
    sources: Sequence[SourceDocument], sets: Sequence[str]
) -> tuple[DocumentNode, list[Problem]]:
    """Return the first tree, changed by the others and by the assignments, and all problems.

    Raises `DeploymentError` if a file is unreadable.
    """
    problems = [problem for source in sources for problem in source.problems]
    nodes = [source.node for source in sources if source.node is not None]
    if len(nodes) < len(sources):
        raise DeploymentError(problems)
    root = with_keys(nodes[0])
    for over in nodes[1:]:
        root, found = apply_overlay(root, over)
        problems += found
    for assignment in sets:
        root, found = apply_set(root, assignment, _SECTIONS)
        problems += found
    return root, problems


def _exceeds(root: DocumentNode, limit: int) -> bool:
    """Return whether a tree has more values than `limit`, each use of a shared value counted."""
    waiting, seen = [root], 0
    while waiting:
        node = waiting.pop()
        seen += 1
        if seen > limit:
            return True
        waiting.extend(node.entries.values())
        waiting.extend(node.value if isinstance(node.value, tuple) else ())
    return False


def _order(problem: Problem, origins: list[str]) -> tuple[int, int, int]:
    at = problem.at
    file = origins.index(at.origin) if at.origin in origins else len(origins)
    return file, at.line, at.column


def _merged(
    base: DocumentNode, over: DocumentNode, path: KeyPath, problems: list[Problem]
) -> DocumentNode:
    if not isinstance(over.value, Mapping):
        return over
    merged = isinstance(base.value, Mapping)
    entries = dict(base.entries)
    for key, node in over.value.items():
        steps = (*path, key)
        if node.value is None and path[:1] == ("settings",):
            entries[key] = node
        elif node.value is not None:
            nothing = DocumentNode({}, node.at, node.key_at)
            entries[key] = _merged(entries.get(key, nothing), node, steps, problems)
        elif entries.pop(key, None) is None:
            remedy = suggestion(key, base.entries) if base.entries else "remove the line"
            problems.append(
                Problem(node.where, dotted(steps), "null removes a key, and there is none", remedy)
            )
    return (
        DocumentNode(entries, base.at, base.key_at)
        if merged
        else DocumentNode(entries, over.at, over.key_at)
    )


def _target(
    base: DocumentNode, keys: list[str], at: Location, sections: frozenset[str]
) -> tuple[KeyPath, Problem | None]:
    if keys[0] == "components" and len(keys) > 1:
        places = {name: path for name, path, _ in component_nodes(base)}
        if keys[1] not in places:
            found = f"there is no component {keys[1]}"
            return (), Problem(at, ".".join(keys[:2]), found, suggestion(keys[1], places))
        return (*places[keys[1]], *keys[2:]), None
    if keys[0] == FRAMES and len(keys) > 2 and base.find(FRAMES, keys[1]) is None:
        known_frames = base.entries[FRAMES].entries if FRAMES in base.entries else ()
        found = f"there is no frame {keys[1]} below {FRAMES}"
        return (), Problem(at, ".".join(keys[:2]), found, suggestion(keys[1], known_frames))
    if keys[0] in sections and keys[0] != "settings":
        return tuple(keys), None
    names = keys[1:] if keys[0] == "settings" else keys
    if base.find("settings", *names) is None:
        settings = base.find("settings")
        known = [] if settings is None else [".".join(steps) for steps in settings.key_paths()]
        found = f"there is no setting {'.'.join(names)}"
        return (), Problem(at, "", found, suggestion(".".join(names), known))
    return ("settings", *names), None


def _nested(steps: KeyPath, value: DocumentNode, at: Location) -> DocumentNode:
    node = DocumentNode(value.value, at, at)
    for step in reversed(steps):
        node = DocumentNode({step: node}, at, at)
    return node
