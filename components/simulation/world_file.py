"""World files: walls, furniture, objects, people and events, as YAML."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, model_validator

from cairn import CairnError, Config
from cairn.components.simulation.refusals import what_is_wrong

Meters = Annotated[float, Field(ge=-10_000, le=10_000)]
Length = Annotated[float, Field(gt=0, le=1000)]
Place = tuple[Meters, Meters]
Height = Annotated[float, Field(gt=0, le=20)]
Surface = Literal["plain", "dark", "glass"]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.-]+$")]


class Placed(Config):
    """A pose in the world."""

    x: float = Field(ge=-10_000, le=10_000, description="x [m].")
    y: float = Field(ge=-10_000, le=10_000, description="y [m].")
    theta: float = Field(0.0, ge=-2 * math.pi, le=2 * math.pi, description="Heading [rad].")

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y [m], heading [rad]."""
        return self.x, self.y, self.theta


class Wall(Config):
    """A line of wall, without thickness."""

    points: list[Place] = Field(min_length=2, description="Corners x, y [m], in order.")
    surface: Surface = Field("plain", description="What a beam meets.")
    height: Height = Field(2.5, description="Its height [m], for cameras; beams always meet it.")


class Furniture(Placed):
    """A piece of furniture: a simple polygon that can be moved."""

    name: Name = Field(description="Its name, that of nothing else.")
    outline: list[Place] = Field(
        default_factory=list, description="Corners x, y in its own frame [m]; or give size."
    )
    size: tuple[Length, Length] | None = Field(
        None, description="Width and depth [m] of a rectangle around its pose, instead of outline."
    )
    surface: Surface = Field("plain", description="What a beam meets.")
    height: Height = Field(0.8, description="Its height [m], for cameras; beams always meet it.")

    @property
    def called(self) -> str:
        """Its name."""
        return self.name

    @model_validator(mode="after")
    def _one_shape(self) -> Furniture:
        if bool(self.outline) == (self.size is not None):
            raise ValueError("give outline or size, one of them")
        if self.outline and len(self.outline) < 3:
            raise ValueError("an outline has at least 3 corners")
        return self

    @property
    def corners(self) -> list[Place]:
        """Corners in its own frame [m]."""
        if self.size is None:
            return self.outline
        half_width, half_depth = self.size[0] / 2, self.size[1] / 2
        return [
            (-half_width, -half_depth),
            (half_width, -half_depth),
            (half_width, half_depth),
            (-half_width, half_depth),
        ]


class VisibleObject(Placed):
    """A textured object that the camera knows; theta is the direction in which it faces."""

    id: int = Field(ge=1, le=1_000_000, description="Its number in the visual map [1].")
    name: Annotated[str, Field(max_length=60, pattern=r"^[A-Za-z0-9_.-]*$")] = Field(
        "", description="Its name; object_ID if none is given."
    )
    width: float = Field(0.3, ge=0.01, le=10, description="Its width [m].")
    height: float | None = Field(
        None, ge=0.01, le=10, description="Its height [m]; none: as its width."
    )
    z: float = Field(1.0, gt=0, le=20, description="Height of its middle above the floor [m].")
    texture: Path | None = Field(
        None,
        description="Picture on it, relative to the world file; none: one drawn for its id.",
    )
    solid: bool = Field(False, description="Whether it stops beams and the robot: a panel.")

    @property
    def called(self) -> str:
        """Its name."""
        return self.name or f"object_{self.id}"

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        return self.width, self.width if self.height is None else self.height

    def within(self, folder: Path) -> VisibleObject:
        """The same, its texture's path from there on."""
        if self.texture is None:
            return self
        return self.model_copy(update={"texture": (folder / self.texture).absolute()})


class Person(Config):
    """Somebody who walks from waypoint to waypoint, and back to the first."""

    name: Name = Field(description="Their name, that of nothing else.")
    waypoints: list[Place] = Field(min_length=1, description="Places x, y [m]; the first begins.")
    speed: float = Field(0.8, ge=0, le=3, description="Walking speed [m/s].")
    pause: float = Field(0.0, ge=0, le=3600, description="How long they stand at each place [s].")
    radius: float = Field(0.22, gt=0, le=1, description="Radius [m].")


class Event(Config):
    """Something that happens at a time; one of the changes."""

    at: float = Field(ge=0, le=1e6, description="When, from the beginning [s].")
    move: Name | None = Field(None, description="Furniture, object or person to move; give to.")
    to: Placed | None = Field(None, description="Where to.")
    remove: Name | None = Field(None, description="Furniture, object or person to take away.")
    swap: tuple[Name, Name] | None = Field(None, description="Two things that change places.")
    add_furniture: Furniture | None = Field(None, description="Furniture to put there.")
    add_object: VisibleObject | None = Field(None, description="Object to put there.")
    add_person: Person | None = Field(None, description="Somebody who comes.")
    kidnap: Placed | None = Field(None, description="Where the robot is carried.")

    @model_validator(mode="after")
    def _one_change(self) -> Event:
        kinds = ("move", "remove", "swap", "add_furniture", "add_object", "add_person", "kidnap")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {', '.join(kinds)}")
        if (self.move is None) != (self.to is None):
            raise ValueError("move and to go together")
        return self

    def within(self, folder: Path) -> Event:
        """The same, its object's texture from that folder on."""
        if self.add_object is None:
            return self
        return self.model_copy(update={"add_object": self.add_object.within(folder)})


class WorldFile(Config):
    """A world: what stands in it, who walks, what happens."""

    walls: list[Wall] = Field(min_length=1, description="Walls; the outer ones close the world.")
    furniture: list[Furniture] = Field(default_factory=list, description="What can be moved.")
    objects: list[VisibleObject] = Field(default_factory=list, description="What is recognized.")
    people: list[Person] = Field(default_factory=list, description="Who walks.")
    events: list[Event] = Field(default_factory=list, description="What happens when.")
    robot: Placed = Field(description="Where the robot stands at the beginning.")

    @model_validator(mode="after")
    def _own_names(self) -> WorldFile:
        names = [piece.name for piece in self.furniture]
        names += [person.name for person in self.people]
        names += [one.called for one in self.objects]
        twins = sorted({name for name in names if names.count(name) > 1})
        if twins:
            raise ValueError(f"several things are called {', '.join(twins)}")
        ids = [one.id for one in self.objects]
        twins = sorted({str(one) for one in ids if ids.count(one) > 1})
        if twins:
            raise ValueError(f"several objects have the id {', '.join(twins)}")
        return self


def read_world(file: Path) -> WorldFile:
    """The world of a file, the paths in it from its folder on.

    `CairnError` names file, place, value and remedy.
    """
    try:
        found = yaml.load(file.read_text(encoding="utf-8"), _OneKeyLoader)
    except FileNotFoundError as error:
        raise CairnError(f"{file}: no such world file") from error
    except yaml.MarkedYAMLError as error:
        where = error.problem_mark
        place = f":{where.line + 1}:{where.column + 1}" if where else ""
        raise CairnError(f"{file}{place}: not YAML: {error.problem}") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise CairnError(f"{file}: cannot be read: {error}") from error
    if not isinstance(found, dict):
        raise CairnError(f"{file}: not a world file: it needs the keys walls and robot")
    try:
        world = WorldFile.model_validate(found)
    except ValidationError as error:
        raise CairnError(f"{file}: {what_is_wrong(error, WorldFile)}") from error
    return world.model_copy(
        update={
            "objects": [thing.within(file.parent) for thing in world.objects],
            "events": [event.within(file.parent) for event in world.events],
        }
    )


class _OneKeyLoader(yaml.SafeLoader):
    """Plain YAML in which a key given twice is an error, not a loss."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """A mapping; its keys must differ."""
        seen = set()
        for key, _ in node.value:
            if str(key.value) in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value} is given twice; remove one", key.start_mark
                )
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)
