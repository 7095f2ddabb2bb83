"""What a supervisor tells of its children, for logs and for their status."""

from dataclasses import dataclass
from typing import Literal

What = Literal[
    "starting",  # launched and led to active
    "active",
    "start_failed",
    "stopping",
    "stop_failed",  # a step of stopping failed; it goes on with the next harder one
    "stopped",
    "ended",  # by itself
    "hung",  # killed for not returning from a handler
    "given_up",  # the supervisor itself fails
]
State = Literal["unloaded", "starting", "active", "stopping", "ended"]


@dataclass(frozen=True)
class SupervisionEvent:
    """Something that happened to a child; `child` is the supervisor itself for `given_up`."""

    time_s: float  # on the supervisor's monotonic clock
    child: str
    incarnation: int  # how many times the child has been launched
    what: What
    reason: str = ""
    normal: bool = True  # False for what ended or was stopped by a failure or by force


@dataclass(frozen=True)
class ChildStatus:
    """How a child is; `reason` is that of its last end or failure, "" if it never had one."""

    name: str
    state: State
    incarnation: int
    restarts: int  # launches after an end, not those by order
    reason: str
