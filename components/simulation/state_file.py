"""The state of the world on disk, so that one whose process was killed goes on where it was."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from cairn.components.simulation.people import Walker
from cairn.components.simulation.scene import Scene
from cairn.components.simulation.world import World
from cairn.components.simulation.world_file import Furniture, Person, VisibleObject
from cairn.files import replace_file

# The file begins anew when it is so long [bytes].
_LONG = 200_000


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


class _Moving(BaseModel):
    model_config = ConfigDict(extra="forbid")

    elapsed_s: float
    robot: tuple[float, float, float]
    walkers: list[_Walker]


@dataclass(frozen=True)
class KeptWorld:
    """What stands where, who walks where, and where the robot is, `elapsed_s` after the start."""

    _things: _Things
    _moving: _Moving

    @property
    def elapsed_s(self) -> float:
        """When it was so, since the start [s]."""
        return self._moving.elapsed_s

    def put_into(self, world: World) -> None:
        """Make the world as it was; what happened until then does not happen again."""
        world.robot = self._moving.robot
        world.scene = Scene(
            world.scene.walls,
            {one.name: one for one in self._things.furniture},
            {one.called: one for one in self._things.objects},
            world.scene.version + 1,
        )
        world.walkers = [Walker(**dict(one)) for one in self._moving.walkers]
        world.skip_events(self.elapsed_s)


class StateFile:
    """A file of JSON lines: what stands in the world, and below, again and again, what moves.

    What counts is the newest whole line. A line more costs a twentieth of what replacing the file
    does, and asks nothing of the disk; it is replaced when something else stands or it is long.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._version = -1
        self._size = 0

    def keep(self, world: World, elapsed_s: float) -> None:
        """Write the state down; raises OSError."""
        scene = world.scene
        walkers = [_Walker(**vars(walker)) for walker in world.walkers]
        moving = _Moving(elapsed_s=elapsed_s, robot=world.robot, walkers=walkers)
        line = moving.model_dump_json().encode() + b"\n"
        try:
            if scene.version == self._version and self._size < _LONG:
                with self.file.open("ab") as file:
                    file.write(line)
            else:
                things = _Things(
                    furniture=list(scene.furniture.values()), objects=list(scene.objects.values())
                )
                line = things.model_dump_json().encode() + b"\n" + line
                # A world does not outlive its computer: nobody waits for a disk.
                replace_file(self.file, line, durable=False)
                self._version, self._size = scene.version, 0
        except OSError:
            self._version = -1  # half a line may stand there now
            raise
        self._size += len(line)

    def kept(self) -> KeptWorld | None:
        """The state in the file; None if there is none that can be read."""
        try:
            things, *moving = self.file.read_bytes().split(b"\n")[:-1]
            return KeptWorld(
                _Things.model_validate_json(things), _Moving.model_validate_json(moving[-1])
            )
        except (OSError, ValueError, LookupError):
            return None
