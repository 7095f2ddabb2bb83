"""Missions: the sequence of goals (waypoints) to drive to, checked and kept on disk."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cairn import CairnError
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.schemas.cairn_nav_msgs import MAX_COORDINATE, MAX_GOALS, MAX_MOTION, MissionOutcome
from cairn.system.files import explain_os_error, replace_file

Goal = tuple[float, float, float]
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]


class _Stored(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


S = TypeVar("S", bound=_Stored)


class ActionRecord(_Stored):
    """The goal of an action: `name` of the action, `goal_id` (hexadecimal, 16 bytes).

    For `follow_waypoints`: the rounds that are left after the current one, and the waypoints that
    were missed, with their error codes.
    """

    name: str
    goal_id: str = Field(pattern="^[0-9a-f]{32}$")
    rounds_left: int = Field(0, ge=0)
    missed: tuple[tuple[int, int], ...] = ()


class MotionRecord(_Stored):
    """A motion that a mission has instead of goals: the fields of `NavigateGoal`."""

    motion: int = Field(ge=1, le=2)
    amount: float = Field(ge=-MAX_MOTION, le=MAX_MOTION)
    speed: float = Field(ge=0, allow_inf_nan=False)
    time_allowance: float = Field(ge=0, allow_inf_nan=False)


class MissionRequest(_Stored):
    """What does not change during a mission: goals x, y [m], heading [rad] in frame map.

    Or a `motion` instead of goals. `requested_ns` is the time of the request, by the supervisor's
    clock. `configured`: it is the mission of the deployment; `replaces_configured`: it, or one
    before it, preempted that mission; `explores`: it is the explorer's. `action` has the goal of an
    action that the mission carries out.
    """

    mission_id: int
    requested_ns: int
    goals: tuple[tuple[Coordinate, Coordinate, Coordinate], ...] = Field(max_length=MAX_GOALS)
    motion: MotionRecord | None = None
    configured: bool = False
    replaces_configured: bool = False
    explores: bool = False
    action: ActionRecord


class MissionResult(_Stored):
    """How a mission ended, and why: the number of a `ReasonCode`, and words."""

    outcome: MissionOutcome
    code: int = Field(ge=0, le=255)
    reason: str

    def __str__(self) -> str:
        """Return the result in words."""
        return f"{self.outcome.name.lower()}: {self.reason}"


class MissionProgress(_Stored):
    """How far a mission is: the index `first` of its current goal, and its result.

    `result` is None while the mission is under way. `resumed` counts how often a restarted
    supervisor continued it.
    """

    mission_id: int
    first: int = Field(0, ge=0, le=MAX_GOALS)
    result: MissionResult | None = None
    resumed: int = Field(0, ge=0)


class Mission(MissionProgress, MissionRequest):
    """A mission with its progress."""

    @property
    def ends_configured(self) -> bool:
        """Whether the deployment's mission ends with it: it is that mission, or replaces it."""
        return self.configured or self.replaces_configured


def check_goals(goals: Sequence[Goal]) -> tuple[Goal, ...]:
    """Return the goals of a mission; raises `CairnError` with the first that is not valid."""
    if len(goals) > MAX_GOALS:
        raise CairnError(
            f"{len(goals):,} goals: a mission has at most {MAX_GOALS:,}; send the further ones "
            "when it has ended"
        )
    for number, goal in enumerate(goals, start=1):
        if not all(math.isfinite(value) and abs(value) <= MAX_COORDINATE for value in goal):
            raise CairnError(
                f"goal {number} = {list(goal)!r}: x, y and heading must be finite, "
                f"and at most {MAX_COORDINATE:g}"
            )
    return tuple(goals)


class MissionFile:
    """A mission on disk: its goals, written once, and beside them its progress.

    Both are replaced atomically, the goals first. So the progress of another mission, which a
    process that was killed in between leaves behind, is of an earlier one, and does not count.
    """

    def __init__(self, file: Path) -> None:
        """Keep the goals in `file`, the progress in `NAME.progress` beside it."""
        self.file = file
        self.progress_file = file.with_name(f"{file.name}.progress")
        self._goals_of: int | None = None  # the mission whose goals are in the file

    def remove(self) -> None:
        """Remove the mission; raises `OSError`."""
        self._goals_of = None
        self.file.unlink(missing_ok=True)
        self.progress_file.unlink(missing_ok=True)

    def save(self, mission: Mission) -> None:
        """Save the mission as it is now.

        Raises `OSError` if that fails. Then a mission that was preempted or has ended is removed,
        so that no restarted supervisor continues it.
        """
        try:
            if not self.holds(mission):
                replace_file(self.file, _json(mission, MissionRequest))
                self._goals_of = mission.mission_id
            replace_file(self.progress_file, _json(mission, MissionProgress))
        except OSError:
            if mission.result or not self.holds(mission):
                with suppress(OSError):
                    self.remove()
            raise

    def holds(self, mission: Mission) -> bool:
        """Return whether the goals of a mission are on the disk, perhaps with earlier progress."""
        return self._goals_of == mission.mission_id

    def load(self) -> Mission | None:
        """Return the mission, None if there is none; raises `CairnError` if a file is invalid."""
        request = _read(self.file, MissionRequest)
        if request is None:
            return None
        progress = _read(self.progress_file, MissionProgress)
        if progress is None or progress.mission_id < request.mission_id:
            progress = MissionProgress(mission_id=request.mission_id)
        if progress.mission_id > request.mission_id or progress.first > len(request.goals):
            raise CairnError(
                f"{self.progress_file}: the progress (mission {progress.mission_id}, goal "
                f"{progress.first}) does not belong to the {len(request.goals)} goals of mission "
                f"{request.mission_id} in {self.file}; send the goals again"
            )
        self._goals_of = request.mission_id
        return Mission.model_validate({**dict(request), **dict(progress)})


def _json(mission: Mission, part: type[_Stored]) -> bytes:
    return mission.model_dump_json(include=set(part.model_fields)).encode()


def _read(file: Path, model: type[S]) -> S | None:
    """Return what is in a file, None without a file; raises `CairnError` if it is invalid."""
    try:
        return model.model_validate_json(read_bounded(file, STATE_BYTES))
    except FileNotFoundError:
        return None
    except OSError as error:
        reason = explain_os_error(error)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        reason = f"{'.'.join(map(str, first['loc']))}: {first['msg']}".removeprefix(": ")
    raise CairnError(f"{file} is not part of a mission: {reason}; send the goals again")
