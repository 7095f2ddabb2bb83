"""Quality of service of a port, in ROS 2's terms."""

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class Qos:
    """How the messages of a port are kept and delivered.

    `depth` is the number of newest messages kept for a reader that is slow, and, where
    durability is transient local, for readers that come late.
    """

    reliability: Literal["reliable", "best_effort"]
    durability: Literal["volatile", "transient_local"]
    depth: int

    def __post_init__(self) -> None:
        """Refuse a depth that keeps nothing."""
        if self.depth < 1:
            raise ValueError(f"depth = {self.depth}: a port keeps at least 1 message")

    def with_depth(self, depth: int) -> "Qos":
        """The same with another depth."""
        return replace(self, depth=depth)


RELIABLE = Qos("reliable", "volatile", 10)
"""For commands and data of which every message counts."""

SENSOR = Qos("best_effort", "volatile", 5)
"""For sensors: the newest matters."""

LATCHED = Qos("reliable", "transient_local", 1)
"""For state such as maps: who comes late gets the last one."""
