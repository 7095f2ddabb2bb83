"""Missions: the sequence of goals (waypoints) to drive to, checked and kept on disk."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from cairn import CairnError
from cairn.bounded_files import STATE_BYTES, read_bounded
from cairn.files import replace_file

Goal = tuple[float, float, float]
LARGEST_COORDINATE = 1e5
"""Coordinates of goals are at most so large [m]."""
_LONGEST_TOKEN = 64


class Mission(BaseModel):
    """A mission: goals x, y [m], heading [rad] in frame map, from index `first` on.

    `requested_ns` is the time of the request, by the supervisor's clock. `result` is empty while
    the mission is under way. `configured`: it is the mission of the deployment;
    `replaces_configured`: it, or one before it, preempted that mission. `resumed` counts how often
    a restarted supervisor continued it. A client that chose a `token` can cancel the mission
    without knowing its id.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    mission_id: int
    requested_ns: int
    goals: tuple[Goal, ...]
    first: int = 0
    result: str = ""
    configured: bool = False
    replaces_configured: bool = False
    resumed: int = 0
    token: str | None = None

    @property
    def ends_configured(self) -> bool:
        """Whether the deployment's mission ends with it: it is that mission, or replaces it."""
        return self.configured or self.replaces_configured


def parse_goals(value: Any) -> tuple[Goal, ...]:
    """Return the goals of a request; raises `CairnError` with the invalid one."""
    if not isinstance(value, list) or not value:
        raise CairnError("a mission has at least one goal [x, y, heading]")
    return tuple(_parse_goal(number, goal) for number, goal in enumerate(value, start=1))


def _parse_goal(number: int, goal: Any) -> Goal:
    numbers = isinstance(goal, list | tuple) and all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in goal
    )
    if not numbers or len(goal) != 3:
        raise CairnError(f"goal {number} = {goal!r}: give x [m], y [m] and heading [rad]")
    if not all(math.isfinite(value) and abs(value) <= LARGEST_COORDINATE for value in goal):
        raise CairnError(
            f"goal {number} = {list(goal)!r}: x, y and heading must be finite, "
            f"and at most {LARGEST_COORDINATE:g}"
        )
    return float(goal[0]), float(goal[1]), float(goal[2])


def parse_token(value: Any) -> str | None:
    """Return the token of a request, None if it has none; raises `CairnError` if it is invalid."""
    if value is not None and not (isinstance(value, str) and 0 < len(value) <= _LONGEST_TOKEN):
        raise CairnError(f"token = {value!r:.80}: give 1 to {_LONGEST_TOKEN} characters")
    return value


def save_mission(file: Path, mission: Mission) -> None:
    """Replace the file atomically; raises `OSError`."""
    replace_file(file, mission.model_dump_json().encode())


def load_mission(file: Path) -> Mission | None:
    """Return the mission in a file, None without a file; raises `CairnError` if it is invalid."""
    try:
        return Mission.model_validate_json(read_bounded(file, STATE_BYTES))
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise CairnError(f"{file} does not hold a mission: {error}") from error
