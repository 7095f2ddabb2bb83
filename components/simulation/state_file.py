"""The state of the world on disk, so that one whose process was killed goes on where it was."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from components.simulation.people import Walker
from components.simulation.world import World
from components.simulation.world_file import Furniture, Person, VisibleObject


class _WalkerState(BaseModel):
    model_config = ConfigDict(extra="forbid")

    person: Person
    x: float
    y: float
    goal: int
    backwards: bool


class WorldFileState(BaseModel):
    """What stands where, who walks where, and where the robot is, `elapsed_s` after the start."""

    model_config = ConfigDict(extra="forbid")

    elapsed_s: float
    robot: tuple[float, float, float]
    furniture: list[Furniture]
    objects: list[VisibleObject]
    walkers: list[_WalkerState]

    def put_into(self, world: World) -> None:
        """Make the world as it was."""
        world.robot = self.robot
        world.scene.furniture = {one.name: one for one in self.furniture}
        world.scene.objects = {one.called: one for one in self.objects}
        world.walkers = [
            Walker(one.person, one.x, one.y, one.goal, backwards=one.backwards)
            for one in self.walkers
        ]
        world.renewed()


def keep_state(file: Path, world: World, elapsed_s: float) -> None:
    """Replace the file by the world's state, at once or not at all."""
    state = WorldFileState(
        elapsed_s=elapsed_s,
        robot=world.robot,
        furniture=list(world.scene.furniture.values()),
        objects=list(world.scene.objects.values()),
        walkers=[
            _WalkerState(person=w.person, x=w.x, y=w.y, goal=w.goal, backwards=w.backwards)
            for w in world.walkers
        ],
    )
    part = file.with_name(file.name + ".part")
    part.write_text(state.model_dump_json(), encoding="utf-8")
    os.replace(part, file)


def kept_state(file: Path) -> WorldFileState | None:
    """The state in a file; None if there is none that can be read."""
    try:
        return WorldFileState.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, ValidationError):
        return None
