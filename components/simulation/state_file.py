"""The state of the world on disk, so that one whose process was killed goes on where it was."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from cairn.files import replace_file
from components.simulation.people import Walker
from components.simulation.scene import Scene
from components.simulation.world import World
from components.simulation.world_file import Furniture, Person, VisibleObject


class _Things(BaseModel):
    model_config = ConfigDict(extra="forbid")

    furniture: list[Furniture]
    objects: list[VisibleObject]


class _Walker(BaseModel):
    model_config = ConfigDict(extra="forbid")

    person: Person
    x: float
    y: float
    goal: int
    paused_s: float
    blocked_s: float
    backwards: bool
    detour: list[tuple[float, float, float]] = []


class KeptWorld(BaseModel):
    """What stands where, who walks where, and where the robot is, `elapsed_s` after the start."""

    model_config = ConfigDict(extra="forbid")

    elapsed_s: float
    robot: tuple[float, float, float]
    walkers: list[_Walker]
    things: _Things

    def put_into(self, world: World) -> None:
        """Make the world as it was; what happened until then does not happen again."""
        world.robot = self.robot
        world.scene = Scene(
            world.scene.walls,
            {one.name: one for one in self.things.furniture},
            {one.called: one for one in self.things.objects},
            world.scene.version + 1,
        )
        world.walkers = [Walker(**dict(one)) for one in self.walkers]
        world.skip_events(self.elapsed_s)


class StateFile:
    """A file that is replaced by the world's state again and again, at once or not at all."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._things = ""
        self._version = -1

    def keep(self, world: World, elapsed_s: float) -> None:
        """Write the state down; raises OSError."""
        scene = world.scene
        if scene.version != self._version:  # most of it stays the same for long
            self._version = scene.version
            self._things = _Things(
                furniture=list(scene.furniture.values()), objects=list(scene.objects.values())
            ).model_dump_json()
        moving = KeptWorld(
            elapsed_s=elapsed_s,
            robot=world.robot,
            walkers=[_Walker(**vars(walker)) for walker in world.walkers],
            things=_Things(furniture=[], objects=[]),
        ).model_dump_json(exclude={"things"})
        state = f'{moving[:-1]},"things":{self._things}}}'
        # Ten times a second nobody waits for a disk; a world does not outlive its computer.
        replace_file(self.file, state.encode(), durable=False)

    def kept(self) -> KeptWorld | None:
        """The state in the file; None if there is none that can be read."""
        try:
            return KeptWorld.model_validate_json(self.file.read_text(encoding="utf-8"))
        except (OSError, ValueError, ValidationError):
            return None
