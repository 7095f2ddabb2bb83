"""A component that receives words, has parameters and publishes commands."""

from pydantic import Field

from cairn import LATCHED, RELIABLE, Component, Config, In, Out, on
from cairn.runtime.component import ComponentContext
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.std_msgs import String


class Limits(Config):
    high: float = Field(1.0, gt=0, le=5, description="Greatest speed [m/s].")


class BaseConfig(Config):
    gain: float = Field(0.5, ge=0, le=1, description="Gain [1].")
    limits: Limits = Field(default_factory=Limits, description="Limits.")


class Base(Component):
    """Receives words, has parameters, publishes commands."""

    config: BaseConfig
    word: In[String] = In(qos=RELIABLE.with_depth(5))
    map: In[String] = In(qos=LATCHED)
    cmd_vel: Out[Twist]

    def __init__(self, context: ComponentContext) -> None:
        super().__init__(context)
        self.calls: list[str] = []

    @on("word")
    def receive(self, word: String) -> None:
        self.calls.append(word.data)

    @on("map")
    def receive_map(self, word: String) -> None:
        self.calls.append(f"map {word.data}")


def word(data: str) -> String:
    return String(data=data)
