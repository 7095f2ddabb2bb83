"""The state of the world on disk, so that a restarted world continues where it was killed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.people import Walker
from cairn.components.simulation.world import World
from cairn.components.simulation.world_file import Furniture, Person, VisibleObject
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.system.files import replace_file

# The file is rewritten when it is longer than this [bytes].
_MAX_BYTES = 200_000


class _SavedLayout(BaseModel):
    model_config = ConfigDict(extra="forbid")

    furniture: list[Furniture]
    objects: list[VisibleObject]


class _SavedWalker(BaseModel):
    model_config = ConfigDict(extra="forbid")

    person: Person
    x: float
    y: float
    goal: int
    paused_s: float
    blocked_s: float
    backwards: bool
    detour: list[tuple[float, float, float]] = []


class _SavedMotion(BaseModel):
    model_config = ConfigDict(extra="forbid")

    elapsed_s: float
    robot: tuple[float, float, float]
    robots: dict[str, tuple[float, float, float]] = {}
    walkers: list[_SavedWalker]


@dataclass(frozen=True)
class SavedWorld:
    """The saved layout, people and robot pose at `elapsed_s` after the start."""

    _layout: _SavedLayout
    _motion: _SavedMotion

    @property
    def elapsed_s(self) -> float:
        """Time of the state since the start [s]."""
        return self._motion.elapsed_s

    def restore(self, world: World) -> None:
        """Set a world to this state; events up to then do not happen again."""
        world.robot = self._motion.robot
        for name, pose in self._motion.robots.items():
            if name in world.robots:
                world.robots[name].pose = pose
        world.layout = WorldLayout(
            world.layout.walls,
            {item.name: item for item in self._layout.furniture},
            {item.display_name: item for item in self._layout.objects},
            world.layout.version + 1,
        )
        world.walkers = [Walker(**dict(item)) for item in self._motion.walkers]
        world.skip_events(self.elapsed_s)


class StateFile:
    """A file of JSON lines: the layout, and below it one line per saved state of what moves.

    The newest complete line counts. Appending a line costs a twentieth of the time of replacing the
    file and does not sync the disk; the file is replaced when the layout changes or when it is
    long.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._version = -1
        self._size = 0

    def save(self, world: World, elapsed_s: float) -> None:
        """Save the state; raises OSError."""
        layout = world.layout
        walkers = [_SavedWalker(**vars(walker)) for walker in world.walkers]
        robots = {name: body.pose for name, body in world.robots.items()}
        motion = _SavedMotion(
            elapsed_s=elapsed_s, robot=world.robot, robots=robots, walkers=walkers
        )
        line = motion.model_dump_json().encode() + b"\n"
        try:
            if layout.version == self._version and self._size < _MAX_BYTES:
                with self.file.open("ab") as file:
                    file.write(line)
            else:
                layout_state = _SavedLayout(
                    furniture=list(layout.furniture.values()), objects=list(layout.objects.values())
                )
                line = layout_state.model_dump_json().encode() + b"\n" + line
                # The state need not survive a power failure, so it is not synced to the disk.
                replace_file(self.file, line, durable=False)
                self._version, self._size = layout.version, 0
        except OSError:
            self._version = -1  # the file may end with half a line now
            raise
        self._size += len(line)

    def load(self) -> SavedWorld | None:
        """Return the saved state; None if the file has no readable one."""
        try:
            layout_state, *motion = read_bounded(self.file, STATE_BYTES).split(b"\n")[:-1]
            return SavedWorld(
                _SavedLayout.model_validate_json(layout_state),
                _SavedMotion.model_validate_json(motion[-1]),
            )
        except (OSError, ValueError, LookupError):
            return None
