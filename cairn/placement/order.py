"""What a process is told of the component that it is to run, as JSON."""

from typing import Any

from pydantic import BaseModel, ConfigDict

from cairn.deployment.model import ComponentSpec
from cairn.runtime.runtime import RuntimeOptions


class Surroundings(BaseModel):
    """What all components of a deployment share."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: str
    domain: int
    endpoints: tuple[str, ...]
    simulated_time: bool
    seed: int
    zygote: str
    log_folder: str


class Order(BaseModel):
    """One component to be run, with all below it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    parent: str
    incarnation: int
    previous_exit: str = ""
    spec: ComponentSpec
    surroundings: Surroundings

    def runtime_options(self) -> RuntimeOptions:
        """What the component's runtime is told."""
        return RuntimeOptions(
            name=self.name,
            plugin=self.spec.plugin,
            robot=self.surroundings.robot,
            parent=self.parent,
            placement=self.spec.placement,
            parameters=self.spec.parameters,
            topics=self.spec.topics,
            simulated_time=self.surroundings.simulated_time,
            seed=self.surroundings.seed,
            restarts=self.incarnation - 1,
            previous_exit=self.previous_exit,
            children=tuple(self.spec.children),
        )


def as_json(order: Order) -> dict[str, Any]:
    """The order as plain JSON values."""
    return order.model_dump(mode="json")
