"""Options that several commands share."""

from pathlib import Path
from typing import Annotated, Final

import typer

from cairn.bus.endpoints import DOMAIN_VARIABLE, MAX_DOMAIN, parse_domain
from cairn.deployment.shipped import deployment_file
from cairn.terminal import completion

Connect = Annotated[
    str,
    typer.Option(
        envvar="CAIRN_CONNECT",
        help="Where the deployment's router listens: the path of a socket, or tcp/HOST:PORT.",
        metavar="ENDPOINT",
        show_default="the socket of your deployment in this domain",
    ),
]
DEFAULT_CONNECT: Final = ""
"""The socket by the rule of `cairn.system.runtime_folder`."""


def _domain(text: str) -> int:
    try:
        return parse_domain(str(text))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} {error}") from error


Domain = Annotated[
    int,
    typer.Option(
        envvar=DOMAIN_VARIABLE,
        parser=_domain,
        help=f"ROS domain of the deployment, 0 to {MAX_DOMAIN}.",
        metavar="N",
    ),
]
RobotName = Annotated[
    str,
    typer.Option("--robot", help="Name of the robot, if several share the bus.", metavar="NAME"),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

File = Annotated[
    Path,
    typer.Argument(
        help="Deployment file, or the name of a deployment that Cairn ships (`cairn deployments`).",
        metavar="FILE",
        parser=deployment_file,
        autocompletion=completion.deployments,
    ),
]
Overlay = Annotated[
    list[Path] | None,
    typer.Option(
        "--overlay",
        help="A file, or a shipped overlay, whose values replace earlier ones.",
        metavar="FILE",
        parser=deployment_file,
        autocompletion=completion.overlays,
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", help="Replace one value.", metavar="KEY.PATH=VALUE"),
]
Machine = Annotated[
    str,
    typer.Option(help="Which one of the deployment's `machines` this computer is.", metavar="NAME"),
]
