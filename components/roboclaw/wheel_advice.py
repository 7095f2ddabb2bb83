"""What follows from turning a base's wheels one after the other: parameters, and what to rewire."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Wheel = Literal["left", "right", "none"]
Direction = Literal["ahead", "back"]

_FEWEST = 20  # counts: fewer come of a shaft that trembles


@dataclass(frozen=True)
class Turned:
    """What happened when one motor was given positive power."""

    motor: Literal["m1", "m2"]
    counts: int
    """How far its encoder counted."""
    other_counts: int
    """How far the other motor's did, which was off."""
    wheel: Wheel
    """Which wheel somebody saw turn."""
    direction: Direction
    """In which direction that wheel would have moved the base."""


def advice(turned: Sequence[Turned]) -> list[str]:
    """Sentences: faults first; without any, the parameters."""
    faults = [fault for one in turned for fault in _faults(one)]
    seen = [one.wheel for one in turned]
    if "none" not in seen and sorted(seen) != ["left", "right"]:
        faults.append(f"both motors turned the {seen[0]} wheel, as it seems: try again")
    return faults or _parameters(turned)


def _faults(one: Turned) -> list[str]:
    name = one.motor.upper()
    if one.wheel == "none":
        return [f"{name}: no wheel turns: see to its motor's leads, and its battery"]
    if abs(one.counts) < _FEWEST:
        if abs(one.other_counts) >= _FEWEST:
            return [f"{name}: the other motor's encoder counts: exchange the encoders' plugs"]
        return [f"{name}: its wheel turns, and its encoder does not count: see to its cable"]
    if one.counts < 0:
        return [
            f"{name}: its encoder counts against its motor, which would run away: exchange the "
            "encoder's lines A and B, or the motor's leads, or reverse one of them in Motion Studio"
        ]
    return []


def _parameters(turned: Sequence[Turned]) -> list[str]:
    lines = ["set these parameters of roboclaw_base:"]
    for one in sorted(turned, key=lambda one: one.wheel):
        if one.wheel == "left":
            lines.append(f"  left: {one.motor}")
        lines.append(f"  {one.wheel}_inverted: {'true' if one.direction == 'back' else 'false'}")
    return lines
