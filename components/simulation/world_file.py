"""The format of world files in YAML, and the error messages for invalid ones."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import yaml
from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from cairn import CairnError, Config
from cairn.deployment.problems import suggestion
from cairn.limits.yaml import read_yaml, yaml_fault
from cairn.schemas.cairn_sim_msgs import MOST_OBJECTS
from cairn.system.files import explain_os_error

Meters = Annotated[float, Field(ge=-10_000, le=10_000)]
Length = Annotated[float, Field(gt=0, le=1000)]
Point = tuple[Meters, Meters]
Height = Annotated[float, Field(gt=0, le=20)]
Surface = Literal["plain", "dark", "glass"]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.-]+$")]


class WorldPose(Config):
    """A pose in the world."""

    x: float = Field(ge=-10_000, le=10_000, description="x [m].")
    y: float = Field(ge=-10_000, le=10_000, description="y [m].")
    theta: float = Field(0.0, ge=-2 * math.pi, le=2 * math.pi, description="Heading [rad].")

    @property
    def pose(self) -> tuple[float, float, float]:
        """Return x, y [m] and heading [rad]."""
        return self.x, self.y, self.theta


class Wall(Config):
    """A wall without thickness, as a polyline."""

    points: list[Point] = Field(min_length=2, description="Corners x, y [m], in order.")
    surface: Surface = Field("plain", description="What a beam hits.")
    height: Height = Field(2.5, description="Height [m] as cameras see it; beams always hit it.")


class Furniture(WorldPose):
    """A piece of furniture: a simple polygon that can be moved."""

    name: Name = Field(description="Unique name.")
    outline: list[Point] = Field(
        default_factory=list, description="Corners x, y in its own frame [m]; or give size."
    )
    size: tuple[Length, Length] | None = Field(
        None, description="Width and depth [m] of a rectangle around its pose, instead of outline."
    )
    surface: Surface = Field("plain", description="What a beam hits.")
    height: Height = Field(0.8, description="Height [m] as cameras see it; beams always hit it.")

    @property
    def display_name(self) -> str:
        """Return its name."""
        return self.name

    @model_validator(mode="after")
    def _one_shape(self) -> Furniture:
        if bool(self.outline) == (self.size is not None):
            raise ValueError("give either outline or size")
        if self.outline and len(self.outline) < 3:
            raise ValueError("outline must have at least 3 corners")
        return self

    @property
    def corners(self) -> list[Point]:
        """Return the corners in its own frame [m]."""
        if self.size is None:
            return self.outline
        half_width, half_depth = self.size[0] / 2, self.size[1] / 2
        return [
            (-half_width, -half_depth),
            (half_width, -half_depth),
            (half_width, half_depth),
            (-half_width, half_depth),
        ]


class VisibleObject(WorldPose):
    """A textured object that the robot can recognize; theta is the direction that it faces."""

    id: int = Field(ge=1, le=1_000_000, description="Object id in the visual map [1].")
    name: Annotated[str, Field(max_length=60, pattern=r"^[A-Za-z0-9_.-]*$")] = Field(
        "", description="Unique name; empty: object_ID."
    )
    width: float = Field(0.3, ge=0.01, le=10, description="Width [m].")
    height: float | None = Field(
        None, ge=0.01, le=10, description="Height [m]; none: equal to the width."
    )
    z: float = Field(1.0, gt=0, le=20, description="Height of its center above the floor [m].")
    texture: Path | None = Field(
        None,
        description="Picture on it, relative to the world file; none: a picture is drawn for "
        "its id.",
    )
    solid: bool = Field(False, description="Whether it is a panel that stops beams and the robot.")

    @property
    def display_name(self) -> str:
        """Return its name, or object_ID if it has none."""
        return self.name or f"object_{self.id}"

    @property
    def size(self) -> tuple[float, float]:
        """Return width and height [m]."""
        return self.width, self.width if self.height is None else self.height

    def with_textures_in(self, folder: Path) -> VisibleObject:
        """Return a copy whose texture path is relative to `folder`."""
        if self.texture is None:
            return self
        return self.model_copy(update={"texture": (folder / self.texture).absolute()})


class Person(Config):
    """A person that walks from waypoint to waypoint and back to the first."""

    name: Name = Field(description="Unique name.")
    waypoints: list[Point] = Field(
        min_length=1, description="Waypoints x, y [m]; the person starts at the first."
    )
    speed: float = Field(0.8, ge=0, le=3, description="Walking speed [m/s].")
    pause: float = Field(0.0, ge=0, le=3600, description="Pause at each waypoint [s].")
    radius: float = Field(0.22, gt=0, le=1, description="Radius [m].")


class Event(Config):
    """A change of the world at a given time; exactly one kind of change."""

    at: float = Field(ge=0, le=1e6, description="Time since the start [s].")
    move: Name | None = Field(
        None, description="Furniture, object or person to move; give `to` as well."
    )
    to: WorldPose | None = Field(None, description="New pose.")
    remove: Name | None = Field(None, description="Furniture, object or person to remove.")
    swap: tuple[Name, Name] | None = Field(
        None, description="Two things that exchange their poses."
    )
    add_furniture: Furniture | None = Field(None, description="Furniture to add.")
    add_object: VisibleObject | None = Field(None, description="Object to add.")
    add_person: Person | None = Field(None, description="Person to add.")
    kidnap: WorldPose | None = Field(
        None, description="Pose to which the robot is moved without its wheels turning."
    )

    @model_validator(mode="after")
    def _one_change(self) -> Event:
        kinds = ("move", "remove", "swap", "add_furniture", "add_object", "add_person", "kidnap")
        kinds_given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(kinds_given) != 1:
            raise ValueError(f"give exactly one of {', '.join(kinds)}")
        if (self.move is None) != (self.to is None):
            raise ValueError("move needs the key to, and to needs move")
        return self

    def with_textures_in(self, folder: Path) -> Event:
        """Return a copy whose object's texture path is relative to `folder`."""
        if self.add_object is None:
            return self
        return self.model_copy(update={"add_object": self.add_object.with_textures_in(folder)})


class WorldFile(Config):
    """A world: walls, furniture, objects, people, events and the robot's start."""

    walls: list[Wall] = Field(
        min_length=1, description="Walls; the outer ones must close the world."
    )
    furniture: list[Furniture] = Field(
        default_factory=list, description="Furniture, which can be moved."
    )
    objects: list[VisibleObject] = Field(
        default_factory=list,
        max_length=MOST_OBJECTS,
        description="Objects that the robot can recognize.",
    )
    people: list[Person] = Field(default_factory=list, description="People that walk.")
    events: list[Event] = Field(default_factory=list, description="Changes at given times.")
    robot: WorldPose = Field(description="Pose of the robot at the start.")

    @model_validator(mode="after")
    def _own_names(self) -> WorldFile:
        names = [piece.name for piece in self.furniture]
        names += [person.name for person in self.people]
        names += [one.display_name for one in self.objects]
        duplicates = sorted(name for name, count in Counter(names).items() if count > 1)
        if duplicates:
            raise ValueError(f"the name is not unique: {', '.join(duplicates)}; change one")
        ids = [one.id for one in self.objects]
        duplicates = sorted(str(one) for one, count in Counter(ids).items() if count > 1)
        if duplicates:
            raise ValueError(f"the object id is not unique: {', '.join(duplicates)}; change one")
        return self


def read_world(file: Path) -> WorldFile:
    """Read a world file; relative paths in it start at its folder.

    Raises `CairnError` with file, position, value and remedy.
    """
    try:
        content = read_yaml(file)
    except FileNotFoundError as error:
        raise CairnError(f"{file}: no such world file; correct the path") from error
    except OSError as error:
        raise CairnError(f"{file}: cannot be read: {explain_os_error(error)}") from error
    except UnicodeDecodeError as error:
        raise CairnError(f"{file}: cannot be read: {error}") from error
    except yaml.YAMLError as error:
        position, fault = yaml_fault(error)
        raise CairnError(f"{file}{position}: not YAML: {fault}") from error
    if not isinstance(content, dict):
        raise CairnError(
            f"{file}: not a world file; it must be a mapping with the keys walls and robot"
        )
    try:
        world = WorldFile.model_validate(content)
    except ValidationError as error:
        raise CairnError(f"{file}: {describe_errors(error, WorldFile)}") from error
    return world.model_copy(
        update={
            "objects": [thing.with_textures_in(file.parent) for thing in world.objects],
            "events": [event.with_textures_in(file.parent) for event in world.events],
        }
    )


_MOST_ERRORS = 20

_PLAIN = {
    "missing": "must be given",
    "finite_number": "must be a finite number",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "string_type": "must be a string",
    "string_pattern_mismatch": "may contain only letters, digits, _, . and -",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
}


def describe_errors(error: ValidationError, model: type[Config]) -> str:
    """Describe in one line what `model` rejected: key, value, and what the value must be."""
    errors = error.errors()
    more = f"; and {len(errors) - _MOST_ERRORS} more" if len(errors) > _MOST_ERRORS else ""
    return "; ".join(_describe(one, model) for one in errors[:_MOST_ERRORS]) + more


def _describe(error: ErrorDetails, model: type[Config]) -> str:
    path = ""
    for part in error["loc"]:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    kind = error["type"]
    shown = "" if kind in ("missing", "value_error") else f" = {str(error['input'])[:60]!r}"
    reason = _reason(error, model)
    return f"{path}{shown}: {reason}" if path else reason


def _reason(error: ErrorDetails, model: type[Config]) -> str:
    kind, limits = error["type"], error.get("ctx", {})
    if kind in _PLAIN:
        return _PLAIN[kind]
    if kind == "extra_forbidden":
        *path, key = error["loc"]
        return f"unknown key; {suggestion(str(key), _keys_at(model, path))}"
    if kind in ("model_type", "dict_type"):
        return f"must be a mapping with the keys {', '.join(_keys_at(model, error['loc']))}"
    if kind == "too_short":
        return f"must have at least {limits['min_length']} items, not {limits['actual_length']}"
    if kind == "too_long":
        return f"must have at most {limits['max_length']} items, not {limits['actual_length']}"
    reason = error["msg"].removeprefix("Value error, ")
    return re.sub(r"^\w+ should ", "must ", reason[0].lower() + reason[1:])


def _keys_at(model: type[Config], path: Any) -> list[str]:
    """Return the keys of the mapping at a path within a model."""
    for part in path:
        if isinstance(part, str):
            model = next(_models_in(model.model_fields[part].annotation))
    return list(model.model_fields)


def _models_in(annotation: Any) -> Iterator[type[Config]]:
    if get_origin(annotation) is None:
        if isinstance(annotation, type) and issubclass(annotation, Config):
            yield annotation
        return
    for part in get_args(annotation):
        yield from _models_in(part)
