"""Makes a world ready for runs: its maps, where the robot starts, and what happens when."""

from __future__ import annotations

from pathlib import Path

from cairn.components.map_builder.importing import altered, write_map
from cairn.components.simulation.survey import surveyed_grid, surveyed_models, surveyed_objects
from cairn.components.simulation.world_file import Event, read_world
from cairn.deployment.model import Deployment
from cairn.planar.map_file import write_map as write_grid
from cairn.planar.poses import Pose


def survey(world: Path, map_file: Path, visual_map: Path) -> None:
    """Write the maps of a world as it stands at the beginning, as its importers survey it."""
    write_grid(map_file, surveyed_grid(world))
    objects = altered(surveyed_objects(world), {}, ())
    source = f"surveyed of {world.name}"
    write_map(visual_map, source, objects, taught=surveyed_models(world))


def robot_start(world: Path) -> Pose:
    """Where the robot of a world stands at the beginning."""
    return read_world(world).robot.pose


def scripted_events(world: Path, deployment: Deployment) -> dict[str, float]:
    """When [s] each event of a world comes due, by what it is; with those of the deployment."""
    events = list(read_world(world).events)
    for member in deployment.members():
        if member.spec.plugin == "simulated_world":
            more = member.spec.parameters.get("events", ())
            events += [Event.model_validate(event) for event in more]
    return {_called(event): event.at for event in sorted(events, key=lambda event: event.at)}


def _called(event: Event) -> str:
    """What is done to what, and when."""
    person, added = event.add_person, event.add_furniture or event.add_object
    whats = {
        "move": event.move,
        "remove": event.remove,
        "swap": event.swap and " and ".join(event.swap),
        "add": person.name if person else added and added.display_name,
    }
    what = next((f"{verb} {name}" for verb, name in whats.items() if name), "kidnap")
    return f"{what} at {event.at:g} s"
