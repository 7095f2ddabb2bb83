"""What the simulated sensors share: they know the world around the robot, and measure regularly."""

from __future__ import annotations

from collections.abc import Callable

from cairn import LATCHED, RELIABLE, Component, In, on
from cairn.components.simulation.world_tracker import WorldTracker
from cairn.schemas.cairn_sim_msgs import WorldGeometry, WorldState


class WorldSensor(Component):
    """A sensor on a robot in the simulated world."""

    world_state: In[WorldState] = In(qos=RELIABLE.with_depth(200))
    world_geometry: In[WorldGeometry] = In(qos=LATCHED)

    def on_configure(self) -> None:
        """Start without knowledge of the world."""
        self.world = WorldTracker(self.robot)

    @on("world_geometry")
    def on_world_geometry(self, geometry: WorldGeometry) -> None:
        """Take walls, furniture and objects."""
        self.world.update_geometry(geometry)

    @on("world_state")
    def on_world_state(self, state: WorldState) -> None:
        """Take the poses of robot and people."""
        self.world.update_state(state)

    def measure_every(self, period: int, measure: Callable[[], None]) -> None:
        """Call `measure` every `period` [ns] from now on, while active."""
        due = self.clock.now() + period

        def run() -> None:
            nonlocal due
            now = self.clock.now()
            due += period
            # Skip what was missed, and go on at once if the clock was set back.
            if not now < due <= now + period:
                due = now + period
            self.schedule(due, run)
            measure()

        self.schedule(due, run)
