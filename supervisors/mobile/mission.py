"""Orders to move: what is asked, checked, and kept on disk while it is carried out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from cairn import CairnError
from cairn.files import replace_file

Goal = tuple[float, float, float]
FARTHEST = 1e5
"""No coordinate of a goal is larger [m]."""
_LONGEST_TOKEN = 64


class Order(BaseModel):
    """An order to move: goals x, y [m], heading [rad] in frame map, from number `first` on.

    `given_ns` is when it was given, in the supervisor's time. `result` is empty as long as it is
    carried out. `mission`: it is the deployment's own; `in_place_of_mission`: it, or one before it,
    pre-empted the mission. `resumed` counts how often a supervisor that was started anew went on
    with it. By `token` whoever gave it can cancel it without knowing its number.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    mission_id: int
    given_ns: int
    goals: tuple[Goal, ...]
    first: int = 0
    result: str = ""
    mission: bool = False
    in_place_of_mission: bool = False
    resumed: int = 0
    token: str | None = None

    @property
    def of_mission(self) -> bool:
        """Whether the mission ends with it: it is the mission, or stands in its place."""
        return self.mission or self.in_place_of_mission


def checked_goals(given: Any) -> tuple[Goal, ...]:
    """Goals of a request; `CairnError` says which is wrong."""
    if not isinstance(given, list) or not given:
        raise CairnError("an order to move has at least one goal [x, y, heading]")
    return tuple(_checked(number, goal) for number, goal in enumerate(given, start=1))


def _checked(number: int, goal: Any) -> Goal:
    numbers = isinstance(goal, list | tuple) and all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in goal
    )
    if not numbers or len(goal) != 3:
        raise CairnError(f"goal {number} = {goal!r}: give x [m], y [m] and heading [rad]")
    if not all(math.isfinite(value) and abs(value) <= FARTHEST for value in goal):
        raise CairnError(
            f"goal {number} = {list(goal)!r}: x, y and heading must be finite, "
            f"and not beyond {FARTHEST:g}"
        )
    return float(goal[0]), float(goal[1]), float(goal[2])


def checked_token(given: Any) -> str | None:
    """The token of a request, None if none is given; `CairnError` if it is none."""
    if given is not None and not (isinstance(given, str) and 0 < len(given) <= _LONGEST_TOKEN):
        raise CairnError(f"token = {given!r:.80}: give 1 to {_LONGEST_TOKEN} characters")
    return given


def save(file: Path, order: Order) -> None:
    """Replace the file, at once or not at all; raises `OSError`."""
    replace_file(file, order.model_dump_json().encode())


def saved(file: Path) -> Order | None:
    """The order in a file; None if there is none. Raises `CairnError` if it is not readable."""
    try:
        return Order.model_validate_json(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise CairnError(f"{file} does not hold an order to move: {error}") from error
