"""What became of orders to move: their goals, results and what they took."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

Goal = tuple[float, float, float]


@dataclass
class OrderRecord:
    """One order: its goals (x, y [m], heading [rad]), how many were reached, and how it ended."""

    mission_id: int
    goals: list[Goal] = field(default_factory=list)
    reached: int = 0
    state: str = "given"
    reason: str = ""
    seconds: float = 0.0
    recoveries: int = 0

    def summary(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "mission_id": self.mission_id,
            "goals": [list(goal) for goal in self.goals],
            "reached": self.reached,
            "state": self.state,
            "reason": self.reason,
            "seconds": round(self.seconds, 3),
            "recoveries": self.recoveries,
        }


@dataclass(frozen=True)
class Touch:
    """A collision: when [ns], with what, where [m], how fast [m/s]."""

    stamp: int
    what: str
    x: float
    y: float
    speed: float
