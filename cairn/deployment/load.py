"""Loads a deployment: a file with overlays, `--set`s and settings, checked as a whole."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cairn.deployment.check import problems_of
from cairn.deployment.document import MOST_VALUES, Node, read
from cairn.deployment.interpolation import interpolated
from cairn.deployment.model import Deployment
from cairn.deployment.overlays import assigned, overlaid
from cairn.deployment.problems import DeploymentError, Problem

_SECTIONS = frozenset(Deployment.model_fields)


class Source(NamedTuple):
    """A file that was read: its tree, None if that is not possible, and what is wrong with it."""

    file: Path
    node: Node | None
    problems: list[Problem]


def read_sources(file: Path, overlays: Sequence[Path] = ()) -> list[Source]:
    """Read a deployment's file and its overlays, once: one may be a pipe."""
    return [Source(one, *read(one)) for one in (file, *overlays)]


def load_deployment(
    file: Path, overlays: Sequence[Path] = (), sets: Sequence[str] = ()
) -> Deployment:
    """The deployment in a file with overlays and `path=value` assignments laid over it in order.

    Raises `DeploymentError` with all its problems; with those of the syntax alone if a file cannot
    be read.
    """
    return assembled(read_sources(file, overlays), sets)


def assembled(sources: Sequence[Source], sets: Sequence[str] = ()) -> Deployment:
    """As `load_deployment`, of files that were read before."""
    problems = [problem for source in sources for problem in source.problems]
    nodes = [source.node for source in sources if source.node is not None]
    if len(nodes) < len(sources):
        raise DeploymentError(problems)
    root = nodes[0]
    for over in nodes[1:]:
        root, found = overlaid(root, over)
        problems += found
    for assignment in sets:
        root, found = assigned(root, assignment, _SECTIONS)
        problems += found
    root, found, unresolved = interpolated(root)
    problems += found
    if _exceeds(root, MOST_VALUES):
        found_too_much = f"with its settings it holds more than {MOST_VALUES:,} values"
        raise DeploymentError([*problems, Problem(root.at, "", found_too_much, "write fewer")])
    reported = {(problem.path, problem.at.line) for problem in problems}
    problems += [
        one for one in problems_of(root, unresolved) if (one.path, one.at.line) not in reported
    ]
    if problems:
        origins = [str(source.file) for source in sources]
        raise DeploymentError(sorted(problems, key=lambda problem: _order(problem, origins)))
    return Deployment.model_validate(root.plain())


def _exceeds(root: Node, limit: int) -> bool:
    """Whether a tree has more values than that; references share theirs, but not when used."""
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
