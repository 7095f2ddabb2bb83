"""`cairn deploy push`, `list` and `rollback`: releases of a deployment on other computers."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn.cli.releases.contents import Contents, release_contents
from cairn.cli.releases.packages import Packages, packages_of
from cairn.cli.releases.push import Pushed, Target, push, roll_back, targets
from cairn.deployment.load import load_deployment
from cairn.errors import CairnError
from cairn.system.kernel_compilation import deferred_compilation
from cairn.terminal.options import File, Json, Overlay, Set
from cairn.terminal.output import line, note, show

deploy = typer.Typer(help="Bring a deployment to other computers by ssh, and go back.")

Machines = Annotated[
    list[str] | None,
    typer.Option(
        "--machine",
        help="One of the deployment's `machines`; may be repeated.",
        metavar="NAME",
        show_default="all but this computer",
    ),
]
To = Annotated[
    str,
    typer.Option(
        help="The computer as ssh names it, instead of the machine's address.",
        metavar="[USER@]HOST",
    ),
]
Folder = Annotated[
    str,
    typer.Option(
        help="Folder of the robot's releases on the machine.", show_default="/srv/cairn/ROBOT"
    ),
]
SshConfig = Annotated[
    Path | None,
    typer.Option(
        help="Configuration of ssh with users, ports and keys.",
        metavar="FILE",
        exists=True,
        show_default="~/.ssh/config",
    ),
]
Limit = Annotated[float, typer.Option(min=1, help="Limit for the service to become active [s].")]


@deploy.command("push")
def push_release(
    file: File,
    overlay: Overlay = None,
    set_: Set = None,
    machine: Machines = None,
    to: To = "",
    folder: Folder = "",
    wheel: Annotated[
        list[Path] | None,
        typer.Option(
            help="A wheel to install, in place of that of the same package, or in addition.",
            metavar="FILE",
        ),
    ] = None,
    no_index: Annotated[
        bool,
        typer.Option(
            "--no-index", help="Install only the wheels, which have to be complete; no download."
        ),
    ] = False,
    environment: Annotated[
        str,
        typer.Option(
            help="Path of an environment on the machine that has the packages: none is copied.",
            metavar="PATH",
        ),
    ] = "",
    limit: Limit = 240.0,
    keep: Annotated[
        int, typer.Option(min=1, max=1000, help="Releases that stay on the machine.")
    ] = 5,
    ssh_config: SshConfig = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would be copied; connect to no machine.")
    ] = False,
) -> None:
    """Copy a deployment with its files and packages to machines, and restart their services.

    The deployment is checked here, and on the machine before anything changes there. A release that
    does not become active is removed, and the one before runs again. What is the same already is
    not copied. Certificates and passwords are never copied. A machine that fails does not stop the
    others; exit status 1 if one has failed.
    """
    if environment and (wheel or no_index):
        raise CairnError("--environment: no package is copied; leave out --wheel and --no-index")
    with deferred_compilation():
        deployment = load_deployment(file, overlay or (), set_ or ())
        found = list(targets(deployment, machine or [], to, folder, ssh_config))
        contents = {
            one.machine: release_contents(file, overlay or (), set_ or (), one.machine)[1]
            for one in found
        }
    with tempfile.TemporaryDirectory(prefix="cairn-wheels-") as wheels:
        packages = None
        if not environment:
            packages = packages_of(deployment, wheel or [], Path(wheels), no_index=no_index)
        if dry_run:
            for target in found:
                _print_plan(target, contents[target.machine], packages)
            return

        def push_to(target: Target) -> str:
            content = contents[target.machine]
            for text in content.notes:
                note(f"{target.label}: {text}")
            pushed = Pushed(content, packages, environment)
            return push(
                target, pushed, keep=keep, limit_s=limit,
                report=lambda text: line(f"{target.label}: {text}"),
            )  # fmt: skip

        _on_each(found, push_to)


@deploy.command("list")
def list_releases(
    file: File,
    overlay: Overlay = None,
    set_: Set = None,
    machine: Machines = None,
    to: To = "",
    folder: Folder = "",
    ssh_config: SshConfig = None,
    json: Json = False,
) -> None:
    """List the releases on the machines, and what runs. Exit status 1 if one cannot be reached."""
    rows: list[dict[str, Any]] = []
    states: list[str] = []

    def ask(target: Target) -> str:
        state = target.request("state")
        names = {state["previous"]: "previous", state["current"]: "current"}
        rows.extend(
            {"machine": target.label, "release": one["id"], "is": names.get(one["id"], "")}
            | {key: one[key] for key in ("created", "by", "files", "packages")}
            for one in reversed(state["releases"])
        )
        return f"service {state['service']}; folder {state['folder']}"

    deployment = load_deployment(file, overlay or (), set_ or (), import_plugins=False)
    found = list(targets(deployment, machine or [], to, folder, ssh_config))
    failed = _each(found, ask, states.append)
    columns = ("machine", "release", "is", "created", "by", "files", "packages")
    show(rows, columns, as_json=json, nothing="there is no release")
    if not json:
        for text in states:
            line(text)
    if failed:
        raise CairnError("; ".join(failed))


@deploy.command("rollback")
def rollback(
    file: File,
    overlay: Overlay = None,
    set_: Set = None,
    machine: Machines = None,
    to: To = "",
    folder: Folder = "",
    release: Annotated[
        str,
        typer.Option(
            help="Release to go to, as `list` has it.",
            metavar="ID",
            show_default="the previous one",
        ),
    ] = "",
    limit: Limit = 240.0,
    ssh_config: SshConfig = None,
) -> None:
    """Go back to an earlier release, and restart the service; a second time undoes it.

    If that release does not become active, the current one runs again. Exit status 1 if a machine
    has failed.
    """
    deployment = load_deployment(file, overlay or (), set_ or (), import_plugins=False)
    found = list(targets(deployment, machine or [], to, folder, ssh_config))
    _on_each(found, lambda target: roll_back(target, release, limit_s=limit))


def _on_each(found: list[Target], work: Callable[[Target], str]) -> None:
    """Do the work on each machine and print the result; raise `CairnError` if one has failed."""
    if failed := _each(found, work, line):
        raise CairnError("\n".join(failed))


def _each(
    found: list[Target], work: Callable[[Target], str], report: Callable[[str], None]
) -> list[str]:
    """Do the work on each machine, report each result, and return the errors."""
    failed = []
    for target in found:
        try:
            report(f"{target.label}: {work(target)}")
        except CairnError as error:
            failed.append(str(error))
    return failed


def _print_plan(target: Target, contents: Contents, packages: Packages | None) -> None:
    destination = f"{target.host.destination}:{target.folder}"
    size = f"{contents.size / 1e6:.1f} MB in {len(contents.files)} files"
    line(f"{target.label}: {destination}, {size}")
    for package in () if packages is None else packages.names():
        line(f"  package {package}")
    line(f"  {contents.name}")
    for name in contents.files:
        line(f"  {name}")
    for text in contents.notes:
        note(f"{target.label}: {text}")
