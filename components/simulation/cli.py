"""`cairn world`: look at world files, and change the world of a running simulation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.cli.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.cli.output import line, note, show
from cairn.client import connect as connect_to
from cairn.components.simulation.checks import problems_of
from cairn.components.simulation.columns import NEAR_M
from cairn.components.simulation.photography import seen_from, write_picture
from cairn.components.simulation.pictures import draw_world
from cairn.components.simulation.scene import Scene
from cairn.components.simulation.walls import cut_off
from cairn.components.simulation.world_file import read_world

app = typer.Typer(
    help="Simulated worlds: check and draw their files, change the one that runs.",
    no_args_is_help=True,
)

# Coordinates may begin with a minus.
_NUMBERS = {"ignore_unknown_options": True}
_LIMIT_S = 10.0
_PLUGIN = "simulated_world"

File = Annotated[Path, typer.Argument(help="World file.", metavar="FILE")]
Name = Annotated[str, typer.Argument(help="Its name.", metavar="NAME")]
X = Annotated[str, typer.Argument(help="x [m].", metavar="X")]
Y = Annotated[str, typer.Argument(help="y [m].", metavar="Y")]
Theta = Annotated[str, typer.Argument(help="Heading in radians, or as 90deg.", metavar="[HEADING]")]
Radius = Annotated[float, typer.Option(min=0.01, help="Radius of the robot [m].")]


@app.command()
def check(file: File, radius: Radius = 0.22) -> None:
    """Say what is in a world file, or what is wrong with it."""
    world = read_world(file)
    problems = problems_of(world, radius)
    if problems:
        raise CairnError(f"{file}: " + "; ".join(problems))
    line(
        f"{file}: {len(world.walls)} walls, {len(world.furniture)} pieces of furniture, "
        f"{len(world.objects)} objects, {len(world.people)} people, {len(world.events)} events"
    )
    for part in cut_off(Scene.of(world), world.robot.pose, radius):
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
    """Draw a world file."""
    try:
        draw_world(read_world(file), radius, out)
    except (OSError, ValueError) as error:
        raise CairnError(f"{out} cannot be written: {error}") from error
    line(f"{out} written")


@app.command(context_settings=_NUMBERS)
def see(
    file: File,
    x: X,
    y: Y,
    theta: Annotated[str, typer.Argument(help="Heading in radians, or as 90deg.")],
    out: Annotated[Path, typer.Argument(help="Picture to write: PNG or JPEG.", metavar="PICTURE")],
    right: Annotated[
        bool, typer.Option("--right", help="What the right camera sees, not the left.")
    ] = False,
    height: Annotated[
        float, typer.Option("--height", min=0.05, help="Of the camera above the floor [m].")
    ] = 1.0,
) -> None:
    """Write what the simulated camera would see at a place of a world file, at its beginning."""
    place = _place(x, y, theta)
    world = read_world(file)
    Scene.of(world).refuse_place("the camera", place["x"], place["y"], NEAR_M)
    picture = seen_from(world, (place["x"], place["y"], place["theta"]), height, right)
    write_picture(picture, out)
    line(f"{out} written")


@app.command("list")
def list_things(
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """List what stands and who walks in the running world, and where the robot is."""
    rows = _ask("list", {}, connect, domain, robot)
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
    _ask("move", {"name": name, **_place(x, y, theta)}, connect, domain, robot)
    line(f"{name} moved")


@app.command()
def remove(
    name: Name, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: RobotName = ""
) -> None:
    """Take furniture, an object or a person away."""
    _ask("remove", {"name": name}, connect, domain, robot)
    line(f"{name} taken away")


@app.command(context_settings=_NUMBERS)
def add(
    name: Name,
    x: X,
    y: Y,
    theta: Theta = "0",
    size: Annotated[
        str | None,
        typer.Option(metavar="WIDTH,DEPTH", help="Of a piece of furniture [m]; else 0.5,0.5."),
    ] = None,
    as_object: Annotated[
        int | None, typer.Option("--object", metavar="ID", help="Add an object of this number.")
    ] = None,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Add a piece of furniture, or an object that faces along its heading."""
    given: dict[str, Any] = {"name": name, **_place(x, y, theta)}
    if as_object is not None:
        if size is not None:
            raise CairnError("--object has no --size: give one of them; objects are 0.3 m wide")
        _ask("object", {**given, "id": as_object}, connect, domain, robot)
    else:
        both = _pair(size or "0.5,0.5", "--size {}: write it as WIDTH,DEPTH, such as 0.5,0.4")
        _ask("furniture", {**given, "size": both}, connect, domain, robot)
    line(f"{name} added")


@app.command(context_settings=_NUMBERS)
def person(
    name: Name,
    places: Annotated[list[str], typer.Argument(help="Where they walk.", metavar="X,Y...")],
    speed: Annotated[float, typer.Option(help="Walking speed, 0 to 3 [m/s].")] = 0.8,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Let somebody come who walks from place to place."""
    if not math.isfinite(speed):
        raise CairnError(f"--speed {speed} is not a finite number")
    waypoints = [_pair(place, "{}: write a place as X,Y, such as 2.5,3") for place in places]
    given = {"name": name, "waypoints": waypoints, "speed": speed}
    _ask("person", given, connect, domain, robot)
    line(f"{name} comes")


@app.command(context_settings=_NUMBERS)
def kidnap(
    x: X,
    y: Y,
    theta: Theta = "0",
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Carry the robot somewhere else, without its wheels turning."""
    _ask("kidnap", _place(x, y, theta), connect, domain, robot)
    line("carried off")


def _ask(verb: str, arguments: dict[str, Any], connect: str, domain: int, robot: str) -> Any:
    with connect_to(connect, domain, robot) as client:
        world = client.component_of(_PLUGIN)
        if world is None:
            raise CairnError("no simulated world runs; start one with `cairn up sim`")
        return client.request(world, verb, arguments, timeout_s=_LIMIT_S)


def _place(x: str, y: str, theta: str) -> dict[str, float]:
    turned = theta.removesuffix("deg")
    heading = _number(turned)
    if turned != theta:
        heading = math.radians(heading)
    return {"x": _number(x), "y": _number(y), "theta": math.remainder(heading, 2 * math.pi)}


def _pair(text: str, told: str) -> list[float]:
    """Two numbers with a comma between; `told` is what to say of anything else."""
    parts = text.split(",")
    if len(parts) != 2:
        raise CairnError(told.format(text))
    try:
        pair = [_number(part) for part in parts]
    except CairnError as error:
        raise CairnError(f"{told.format(text)} ({error})") from None
    return pair


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise CairnError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise CairnError(f"{text} is not a finite number")
    return value
