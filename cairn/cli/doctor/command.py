"""The command `cairn doctor`: print all findings as a table, faults with their remedies."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cairn.cli.doctor import Finding
from cairn.cli.doctor.computer import computer, software
from cairn.cli.doctor.deployments import devices, files, loaded, running, who_may_connect
from cairn.cli.doctor.devices import cameras, serial_ports
from cairn.cli.doctor.machines import machines
from cairn.deployment.model import Deployment
from cairn.deployment.shipped import deployment_file
from cairn.processes.process_run import endpoints
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, Overlay, Set
from cairn.terminal.output import line, print_json

_COLORS = {"ok": "green", "warn": "yellow", "fail": "bold red"}
_WIDE = 10_000  # columns, if the output is not a terminal but perhaps `grep`

File = Annotated[
    Path | None,
    typer.Argument(
        help="A deployment, by file or by shipped name, whose files and devices are checked.",
        metavar="FILE",
        parser=deployment_file,
    ),
]


def doctor(
    file: File = None,
    overlay: Overlay = None,
    set_: Set = None,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    json: Json = False,
) -> None:
    """Check this computer, and what a deployment needs of it; print the remedy for each fault.

    Nothing is changed, and no device is opened. Exit status 1 if there is a fault.
    """
    deployment: Deployment | None = None
    of_file: list[Finding] = []
    if file is not None:
        deployment, of_file = loaded(file, overlay or (), set_ or ())
        if deployment is not None:
            connect, domain = endpoints(deployment)[0], deployment.domain
    findings = [*_general(connect, domain), *of_file]
    if file is not None and deployment is not None:
        findings += [*who_may_connect(file, deployment), *files(file, deployment)]
        findings += [*machines(file, deployment), *devices(file, deployment)]
    if json:
        print_json([asdict(finding) for finding in findings])
    else:
        _print(findings)
    if any(finding.state == "fail" for finding in findings):
        raise typer.Exit(1)


def _general(endpoint: str, domain: int) -> Iterator[Finding]:
    yield from software()
    yield from computer()
    yield from serial_ports()
    yield from cameras()
    yield from running(endpoint, domain)


def _print(findings: Sequence[Finding]) -> None:
    width = None if sys.stdout.isatty() else _WIDE
    console = Console(highlight=False, width=width)
    table = Table(box=None, pad_edge=False, show_header=False)
    for _ in range(3):
        table.add_column(overflow="fold")
    topic = ""
    for finding in findings:
        if finding.topic != topic:
            topic = finding.topic
            table.add_row("", Text(topic, style="bold"), "")
        found = Text(finding.found)
        if finding.remedy:
            found.append(f"\n-> {finding.remedy}", style="cyan")
        state = Text(finding.state, style=_COLORS[finding.state])
        table.add_row(state, Text(finding.subject), found)
    with console.capture() as drawn:
        console.print(table)
    for text in drawn.get().splitlines():
        line(text.rstrip())
    faults = sum(finding.state == "fail" for finding in findings)
    warnings = sum(finding.state == "warn" for finding in findings)
    line(f"\n{_count(faults, 'fault')}, {_count(warnings, 'warning')}")


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
