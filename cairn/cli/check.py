"""`cairn check FILE`: all that is wrong with a deployment, before anything starts."""

from typing import Any

import typer

from cairn.cli.options import File, Json, Overlay, Set
from cairn.cli.output import line, print_json
from cairn.deployment.load import load_deployment
from cairn.deployment.problems import DeploymentError, Problem


def check(file: File, overlay: Overlay = None, set_: Set = None, json: Json = False) -> None:
    """Check a deployment as a whole; every problem with file, line and what was expected."""
    try:
        deployment = load_deployment(file, overlay or (), set_ or ())
    except DeploymentError as error:
        if not json:
            raise
        print_json({"valid": False, "problems": [_plain(problem) for problem in error.problems]})
        raise typer.Exit(1) from error
    names = [member.name for member in deployment.members()]
    if json:
        print_json({"valid": True, "components": names})
        return
    line(f"{file}: {len(names)} components, no problem: {', '.join(names)}")


def _plain(problem: Problem) -> dict[str, Any]:
    return {
        "file": problem.at.origin,
        "line": problem.at.line,
        "column": problem.at.column,
        "path": problem.path,
        "found": problem.found,
        "remedy": problem.remedy,
    }
