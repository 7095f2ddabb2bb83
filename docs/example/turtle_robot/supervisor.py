"""The supervisor of the turtle: runs the wanderer while the battery lasts."""

from cairn import Config, In, Supervisor, on
from pydantic import Field

from turtle_robot.messages import BaseState

WANDERER = "wanderer"


class TurtleSupervisorConfig(Config):
    """Parameters of the supervisor."""

    rest_below: float = Field(0.2, ge=0, le=1, description="Charge below which it rests [1].")
    wander_above: float = Field(
        0.5, ge=0, le=1, description="Charge above which it wanders again [1]."
    )


class TurtleSupervisor(Supervisor):
    """Keeps the base running; loads the wanderer at high charge, unloads it at low charge."""

    config: TurtleSupervisorConfig

    base_state: In[BaseState]

    @on("base_state")
    def on_base_state(self, state: BaseState) -> None:
        """Load or unload the wanderer; no effect if that is done already."""
        if state.charge < self.config.rest_below:
            self.children.unload(WANDERER)
        elif state.charge > self.config.wander_above:
            self.children.load(WANDERER)
