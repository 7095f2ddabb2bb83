"""Options that several commands share."""

from pathlib import Path
from typing import Annotated, Final

import typer

from cairn.cli import completion
from cairn.deployment.shipped import deployment_file

__all__ = ["DEFAULT_CONNECT", "Connect", "Domain", "File", "Json", "Overlay", "RobotName", "Set"]

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
"""The socket by the rule of `cairn.runtime_folder`."""
Domain = Annotated[
    int, typer.Option(envvar="ROS_DOMAIN_ID", min=0, max=232, help="ROS domain of the deployment.")
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
