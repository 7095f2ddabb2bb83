"""Quality of service of a port, in ROS 2's terms.

`cairn.bus.zenoh_bus` maps it to Zenoh (`_declare_publisher`, `_declare_subscriber`) and
`cairn.bus.keys` to the liveliness tokens that ROS 2 reads.
"""

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class Qos:
    """How the messages of a port are delivered and kept.

    Args:
        reliability: announced to ROS 2 peers; Cairn itself sends both kinds in the same way.
        durability: `transient_local` (latched) delivers the last messages to late subscribers, too.
        depth: number of newest messages that are kept for a slow subscriber and, if latched, for
            late subscribers; at least 1.

    Raises `ValueError` if `depth` is below 1.
    """

    reliability: Literal["reliable", "best_effort"]
    durability: Literal["volatile", "transient_local"]
    depth: int

    def __post_init__(self) -> None:
        """Reject a depth that keeps nothing."""
        if self.depth < 1:
            raise ValueError(f"depth = {self.depth}: a port keeps at least 1 message")

    def __str__(self) -> str:
        """Return its policies in ROS 2's words: `best_effort, volatile, depth 5`."""
        return f"{self.reliability}, {self.durability}, depth {self.depth}"

    @property
    def latched(self) -> bool:
        """Whether late subscribers receive the last messages."""
        return self.durability == "transient_local"

    def with_depth(self, depth: int) -> "Qos":
        """Return the same quality of service with another depth."""
        return replace(self, depth=depth)


RELIABLE = Qos("reliable", "volatile", 10)
"""For commands and data of which every message counts: the default; depth 10."""

SENSOR = Qos("best_effort", "volatile", 5)
"""For sensor data, of which the newest message matters; depth 5."""

LATCHED = Qos("reliable", "transient_local", 1)
"""For state such as maps: a late subscriber receives the last message; depth 1."""

SERVICES = RELIABLE
"""For services, as ROS 2 peers read it: its default."""
