"""Loads a deployment: a file with overlays, `--set`s and settings, checked as a whole."""

from collections.abc import Sequence
from pathlib import Path

from cairn.deployment.check import problems_of
from cairn.deployment.document import read
from cairn.deployment.interpolation import interpolated
from cairn.deployment.model import Deployment
from cairn.deployment.overlays import assigned, overlaid
from cairn.deployment.problems import DeploymentError, Problem

_SECTIONS = frozenset(Deployment.model_fields)


def load_deployment(
    file: Path, overlays: Sequence[Path] = (), sets: Sequence[str] = ()
) -> Deployment:
    """The deployment in a file with overlays and `path=value` assignments laid over it in order.

    Raises `DeploymentError` with all its problems; with those of the syntax alone if a file cannot
    be read.
    """
    documents = [read(one) for one in (file, *overlays)]
    problems = [problem for _, found in documents for problem in found]
    nodes = [node for node, _ in documents if node is not None]
    if len(nodes) < len(documents):
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
    reported = {problem.path for problem in problems}
    problems += [one for one in problems_of(root, unresolved) if one.path not in reported]
    if problems:
        origins = [str(one) for one in (file, *overlays)]
        raise DeploymentError(sorted(problems, key=lambda problem: _order(problem, origins)))
    return Deployment.model_validate(root.plain())


def _order(problem: Problem, origins: list[str]) -> tuple[int, int, int]:
    at = problem.at
    file = origins.index(at.origin) if at.origin in origins else len(origins)
    return file, at.line, at.column
