"""`cairn check FILE`: all problems of a deployment; `cairn deployments`: those that are shipped."""

from typing import Annotated, Any

import typer

from cairn.deployment.load import assemble, contradictions_of, read_sources
from cairn.deployment.problems import DeploymentError, Problem
from cairn.deployment.qos_mismatches import qos_mismatches
from cairn.deployment.shipped import FOLDER, shipped
from cairn.system.kernel_compilation import deferred_compilation
from cairn.terminal.options import File, Json, Overlay, Set
from cairn.terminal.output import line, print_json, print_problems, show

NoImport = Annotated[
    bool,
    typer.Option(
        "--no-import",
        help="Run no code that the deployment names: for deployments that you do not trust.",
    ),
]

NOT_CHECKED = (
    "parameters",
    "ports and topics",
    "message types",
    "certificates and password files of the bus",
    "classes named as package.module:Class",
)
"""What only the plugins' code knows, and files that the deployment names."""


def check(
    file: File,
    overlay: Overlay = None,
    set_: Set = None,
    no_import: NoImport = False,
    json: Json = False,
) -> None:
    """Check a deployment as a whole; report each problem with file, line and what is expected.

    These are warnings: a parameter that differs from what the section `robot` says, and a QoS that
    does not match by the rules of ROS 2, as Cairn delivers the messages.

    A deployment is code: the check imports the modules that it names, as `cairn up` does. With
    --no-import, it reads the deployment and the metadata of the installed packages only.
    """
    not_checked = {"not_checked": NOT_CHECKED} if no_import else {}
    try:
        with deferred_compilation():  # a check must not wait for kernels
            sources, sets = read_sources(file, overlay or ()), set_ or ()
            deployment = assemble(sources, sets, import_plugins=not no_import)
            warnings = (
                []
                if no_import
                else [
                    *map(str, contradictions_of(sources, sets)),
                    *qos_mismatches(deployment),
                ]
            )
    except DeploymentError as error:
        if not json:
            raise
        problems = [_plain(problem) for problem in error.problems]
        print_json({"valid": False, "problems": problems, **not_checked})
        raise typer.Exit(1) from error
    names = [member.name for member in deployment.members()]
    if json:
        found = {"components": names, "warnings": warnings}
        print_json({"valid": True, **found, **not_checked})
        return
    print_problems(warnings)
    line(f"{file}: {len(names)} components, no problem: {', '.join(names)}")
    if no_import:
        line(f"not checked, because no plugin was imported: {', '.join(NOT_CHECKED)}")


def deployments(json: Json = False) -> None:
    """List the deployments that Cairn ships: `cairn up NAME` runs one.

    An overlay is laid over a deployment: `cairn up sim --overlay demo_tour`. To change one for
    your robot, copy its file.
    """
    rows = [
        {
            "name": one.name,
            "kind": "overlay" if one.is_overlay else "deployment",
            "summary": one.summary,
            "file": str(one.file),
        }
        for one in shipped()
    ]
    show(rows, ("name", "kind", "summary"), as_json=json)
    if not json:
        line(f"\nfiles: {FOLDER}")


def _plain(problem: Problem) -> dict[str, Any]:
    return {
        "file": problem.at.origin,
        "line": problem.at.line,
        "column": problem.at.column,
        "path": problem.path,
        "found": problem.found,
        "remedy": problem.remedy,
    }
