"""`cairn world`: check and draw world files, and change the world of a running simulation.

What draws and checks is imported where it is used: it compiles kernels and loads matplotlib, and
the other commands only send a request.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.client import connect as connect_to
from cairn.deployment.shipped import world_file
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, show

app = typer.Typer(
    help="Check and draw world files; change the world of a running simulation.",
    no_args_is_help=True,
)

# Lets coordinates start with a minus sign.
_NUMBERS = {"ignore_unknown_options": True}
_TIMEOUT_S = 10.0
_PLUGIN = "simulated_world"

File = Annotated[
    Path,
    typer.Argument(
        help="World file, or the name of a world that Cairn ships.",
        metavar="FILE",
        parser=world_file,
    ),
]
Name = Annotated[str, typer.Argument(help="Name.", metavar="NAME")]
X = Annotated[str, typer.Argument(help="x [m].", metavar="X")]
Y = Annotated[str, typer.Argument(help="y [m].", metavar="Y")]
Theta = Annotated[str, typer.Argument(help="Heading in radians, or as 90deg.", metavar="[HEADING]")]
Radius = Annotated[float, typer.Option(min=0.01, help="Radius of the robot [m].")]


@app.command()
def check(file: File, radius: Radius = 0.22) -> None:
    """Check a world file; report its contents or its problems."""
    from cairn.components.simulation.layout import WorldLayout
    from cairn.components.simulation.world_checks import unreachable_areas, world_problems
    from cairn.components.simulation.world_file import read_world

    world = read_world(file)
    problems = world_problems(world, radius)
    if problems:
        raise CairnError(f"{file}: " + "; ".join(problems))
    line(
        f"{file}: {len(world.walls)} walls, {len(world.furniture)} pieces of furniture, "
        f"{len(world.objects)} objects, {len(world.people)} people, {len(world.events)} events"
    )
    for part in unreachable_areas(WorldLayout.of(world), world.robot.pose, radius):
        note(
            f"{file}: warning: {part.area:.1f} m2 around ({part.x:.2f}, {part.y:.2f}) cannot be "
            f"reached from the start by a robot of {radius:g} m radius"
        )


@app.command()
def draw(
    file: File,
    out: Annotated[Path, typer.Argument(help="Picture to write: PNG, PDF or SVG.")],
    radius: Radius = 0.22,
) -> None:
    """Draw a world file as a plan."""
    from cairn.components.simulation.world_drawing import draw_world
    from cairn.components.simulation.world_file import read_world

    try:
        draw_world(read_world(file), radius, out)
    except (OSError, ValueError) as error:
        raise CairnError(f"{out}: cannot be written: {error}; choose another file") from error
    line(f"{out} was written")


@app.command(context_settings=_NUMBERS)
def see(
    file: File,
    x: X,
    y: Y,
    theta: Annotated[str, typer.Argument(help="Heading in radians, or as 90deg.")],
    out: Annotated[Path, typer.Argument(help="Picture to write: PNG or JPEG.", metavar="PICTURE")],
    right: Annotated[
        bool, typer.Option("--right", help="Use the right camera instead of the left one.")
    ] = False,
    height: Annotated[
        float, typer.Option("--height", min=0.05, help="Height of the camera above the floor [m].")
    ] = 1.0,
) -> None:
    """Write the picture that the simulated camera takes at a pose of a world file, at its start."""
    from cairn.components.simulation.camera import seen_from
    from cairn.components.simulation.layout import WorldLayout
    from cairn.components.simulation.render_kernels import NEAR_M
    from cairn.components.simulation.world_file import read_world
    from cairn.vision.images import write_picture

    pose = _pose_arguments(x, y, theta)
    world = read_world(file)
    WorldLayout.of(world).require_room("the camera", pose["x"], pose["y"], NEAR_M)
    picture = seen_from(world, (pose["x"], pose["y"], pose["theta"]), height, right)
    write_picture(picture, out)
    line(f"{out} was written")


@app.command("list")
def list_things(
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """List furniture, objects and people of the running world, and the robot's pose."""
    rows = _request("list", {}, connect, domain, robot)
    columns = {"kind": "kind", "name": "name", "x": "x [m]", "y": "y [m]", "theta": "heading [rad]"}
    show(rows, columns, as_json=json, nothing="the world is empty")


@app.command(context_settings=_NUMBERS)
def move(
    name: Name,
    x: X,
    y: Y,
    theta: Theta = "0",
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Move furniture, an object or a person."""
    _request("move", {"name": name, **_pose_arguments(x, y, theta)}, connect, domain, robot)
    line(f"{name} was moved")


@app.command()
def remove(
    name: Name, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: RobotName = ""
) -> None:
    """Remove furniture, an object or a person."""
    _request("remove", {"name": name}, connect, domain, robot)
    line(f"{name} was removed")


@app.command(context_settings=_NUMBERS)
def add(
    name: Name,
    x: X,
    y: Y,
    theta: Theta = "0",
    size: Annotated[
        str | None,
        typer.Option(metavar="WIDTH,DEPTH", help="Size of the furniture [m]; default 0.5,0.5."),
    ] = None,
    as_object: Annotated[
        int | None, typer.Option("--object", metavar="ID", help="Add an object with this id.")
    ] = None,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Add a piece of furniture, or an object that faces along its heading."""
    arguments: dict[str, Any] = {"name": name, **_pose_arguments(x, y, theta)}
    if as_object is not None:
        if size is not None:
            raise CairnError(
                "--size is for furniture, not for --object (0.3 m wide); give one of them"
            )
        _request("object", {**arguments, "id": as_object}, connect, domain, robot)
    else:
        both = _pair(size or "0.5,0.5", "--size {}: write it as WIDTH,DEPTH, such as 0.5,0.4")
        _request("furniture", {**arguments, "size": both}, connect, domain, robot)
    line(f"{name} was added")


@app.command(context_settings=_NUMBERS)
def person(
    name: Name,
    waypoints: Annotated[list[str], typer.Argument(help="Waypoints [m].", metavar="X,Y...")],
    speed: Annotated[float, typer.Option(help="Walking speed, 0 to 3 [m/s].")] = 0.8,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Add a person that walks from waypoint to waypoint."""
    if not math.isfinite(speed):
        raise CairnError(f"--speed {speed} is not a finite number; give one from 0 to 3")
    points = [_pair(point, "{}: write a waypoint as X,Y, such as 2.5,3") for point in waypoints]
    arguments = {"name": name, "waypoints": points, "speed": speed}
    _request("person", arguments, connect, domain, robot)
    line(f"{name} was added")


@app.command(context_settings=_NUMBERS)
def kidnap(
    x: X,
    y: Y,
    theta: Theta = "0",
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Move the robot without turning its wheels."""
    _request("kidnap", _pose_arguments(x, y, theta), connect, domain, robot)
    line("the robot was moved")


def _request(verb: str, arguments: dict[str, Any], connect: str, domain: int, robot: str) -> Any:
    with connect_to(connect, domain, robot) as client:
        return client.request_plugin(
            _PLUGIN, verb, arguments, missing="start one with `cairn up sim`", timeout_s=_TIMEOUT_S
        )


def _pose_arguments(x: str, y: str, theta: str) -> dict[str, float]:
    turned = theta.removesuffix("deg")
    heading = _number(turned)
    if turned != theta:
        heading = math.radians(heading)
    return {"x": _number(x), "y": _number(y), "theta": math.remainder(heading, 2 * math.pi)}


def _pair(text: str, message: str) -> list[float]:
    """Parse two numbers separated by a comma; `message` is the error for anything else."""
    parts = text.split(",")
    if len(parts) != 2:
        raise CairnError(message.format(text))
    try:
        pair = [_number(part) for part in parts]
    except CairnError as error:
        raise CairnError(f"{message.format(text)} ({error})") from None
    return pair


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise CairnError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise CairnError(f"{text} is not a finite number")
    return value
