"""The format of campaign files in YAML: a strict model, and how it is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from cairn.deployment.load import assemble, read_sources
from cairn.deployment.model import Deployment
from cairn.deployment.shipped import deployment_file
from cairn.errors import CairnError
from cairn.limits.yaml import read_yaml, yaml_fault
from cairn.recording.recorder import RecorderSettings
from cairn.runtime.parameters import Config, error_reason
from cairn.system.files import explain_os_error
from cairn_lab.campaign.entry_points import instance_of
from cairn_lab.campaign.fault import FAULTS
from cairn_lab.campaign.invariants import INVARIANTS

Coordinate = Annotated[float, Field(ge=-10_000, le=10_000)]
Pose = tuple[Coordinate, Coordinate, Annotated[float, Field(ge=-7, le=7)]]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,60}$")]
Command = Annotated[tuple[str, ...], Field(min_length=1, max_length=100)]

_RING = RecorderSettings(last_s=60.0, after_s=2.0, exclude=("camera/**",))


class Kind(Config):
    """A kind of fault or an invariant, with its parameters."""

    kind: str = Field(
        min_length=1,
        max_length=200,
        description="Entry point of group cairn.faults or cairn.invariants, or "
        "package.module:Class.",
    )
    parameters: dict[str, Any] = Field(default_factory=dict, description="Values of its `Config`.")


class FaultKind(Kind):
    """A kind of fault, and how often it is drawn."""

    weight: float = Field(
        1.0, gt=0, le=1000, description="Share of the faults, relative to the other weights."
    )


class Goals(Config):
    """The goals that keep the robot busy."""

    poses: tuple[Pose, ...] = Field(
        (),
        max_length=1000,
        description="Poses x, y [m], heading [rad] in frame map, one after the other; none: "
        "random ones in the free space of the map.",
    )
    clearance: float = Field(
        0.5, gt=0, le=10, description="Distance of random goals to what is not free [m]."
    )
    limit_s: float = Field(
        240.0, gt=0, le=86_400, description="A goal that has not ended by then is canceled [s]."
    )


class Campaign(Config):
    """A campaign: what runs, which faults are injected, and what must hold all the time."""

    cairn_campaign: Literal[1] = Field(description="Version of this format.")
    deployment: str = Field(
        min_length=1,
        description="Deployment file, relative to the campaign's folder, or the name of a shipped "
        "deployment.",
    )
    overlays: tuple[str, ...] = Field(
        (), max_length=100, description="Overlays, as `cairn up --overlay` takes them."
    )
    sets: tuple[str, ...] = Field(
        (), max_length=1000, description="Assignments, as `cairn up --set` takes them."
    )
    programs: dict[Name, Command] = Field(
        default_factory=dict,
        max_length=20,
        description="Programs with arguments that run beside the deployment, such as emulators of "
        "its devices, in the report's folder; each starts before the deployment, and is ready when "
        "it has printed something.",
    )
    seed: int = Field(0, ge=0, lt=1 << 63, description="Seed of the faults and of random goals.")
    duration_s: float | None = Field(
        None, gt=0, le=30 * 86_400, description="The campaign ends after this time [s]."
    )
    count: int | None = Field(
        None, ge=0, le=1_000_000, description="The campaign ends after this many faults."
    )
    interval_s: float = Field(
        60.0,
        gt=0,
        le=86_400,
        description="Mean time between faults [s]; exponentially distributed, at most four times "
        "this.",
    )
    settle_s: float = Field(
        20.0,
        ge=0,
        le=3600,
        description="Time without faults, before the first and after the last one [s].",
    )
    goals: Goals | None = Field(None, description="Goals for the robot; by default none.")
    faults: tuple[FaultKind, ...] = Field(
        min_length=1, max_length=100, description="The kinds of faults."
    )
    invariants: tuple[Kind, ...] = Field(
        (), max_length=100, description="What must hold all the time."
    )
    recording: RecorderSettings | None = Field(
        _RING,
        description="What is recorded, as by the plugin `recorder`: with `last_s`, the last "
        "seconds before each violation; with `last_s: 0`, everything. null: nothing.",
    )

    @model_validator(mode="after")
    def _ends(self) -> Campaign:
        if self.duration_s is None and self.count is None:
            raise ValueError("give duration_s or count (of faults), so that the campaign ends")
        return self

    @model_validator(mode="after")
    def _kinds_exist(self) -> Campaign:
        for fault in self.faults:
            instance_of(FAULTS, fault.kind, fault.parameters)
        for invariant in self.invariants:
            instance_of(INVARIANTS, invariant.kind, invariant.parameters)
        return self

    def read(self, folder: Path) -> CampaignDeployment:
        """Return the deployment; relative paths begin at `folder`.

        Raises `DeploymentError` if it cannot be read; `CairnError` if it is neither a file nor a
        shipped deployment.
        """
        file = _path("deployment", self.deployment, folder)
        overlays = [_path("overlays", one, folder) for one in self.overlays]
        # Recordings that can be re-run need the call log.
        sets = [*self.sets, *([] if self.recording is None else ["call_log=true"])]
        words = [word for one in overlays for word in ("--overlay", str(one))]
        words += [word for one in sets for word in ("--set", one)]
        deployment = assemble(read_sources(file, overlays), sets, import_plugins=False)
        return CampaignDeployment(file, tuple(words), deployment)


@dataclass(frozen=True)
class CampaignDeployment:
    """A deployment as it was read, with the file and the arguments of `cairn up` that give it."""

    file: Path
    arguments: tuple[str, ...]
    deployment: Deployment


def read_campaign(file: Path) -> Campaign:
    """Read a campaign file; raises `CairnError` with file, key, value and remedy."""
    try:
        content = read_yaml(file)
    except FileNotFoundError as error:
        raise CairnError(f"{file}: no such campaign file; correct the path") from error
    except (OSError, UnicodeDecodeError) as error:
        why = explain_os_error(error) if isinstance(error, OSError) else str(error)
        raise CairnError(f"{file}: cannot be read: {why}") from error
    except yaml.YAMLError as error:
        position, fault = yaml_fault(error)
        raise CairnError(f"{file}{position}: not YAML: {fault}") from error
    return parse_campaign(content, str(file))


def parse_campaign(content: object, source: str) -> Campaign:
    """Return the campaign in plain data; raises `CairnError` that begins with `source`."""
    if not isinstance(content, dict) or "cairn_campaign" not in content:
        raise CairnError(
            f"{source}: not a campaign; it must be a mapping that begins with `cairn_campaign: 1`"
        )
    try:
        return Campaign.model_validate(content)
    except ValidationError as error:
        raise CairnError(f"{source}: {_problems(error)}") from error


def _problems(error: ValidationError) -> str:
    details = error.errors()
    places = [one["loc"] for one in details]
    # A list with an invalid item also counts as too short.
    own = [one for one in details if one["type"] != "too_short" or not _has_below(one, places)]
    return "; ".join(map(_problem, own))


def _has_below(detail: ErrorDetails, places: Sequence[tuple[int | str, ...]]) -> bool:
    path = detail["loc"]
    return any(len(other) > len(path) and other[: len(path)] == path for other in places)


def _problem(detail: ErrorDetails) -> str:
    key, value = ".".join(map(str, detail["loc"])), detail["input"]
    if detail["type"] == "extra_forbidden":
        return f"{key}: unknown key; remove it, or correct its name"
    shown = f" = {str(value)[:60]!r}" if key and not isinstance(value, dict | list) else ""
    return f"{key}{shown}: {error_reason(detail)}" if key else error_reason(detail)


def _path(key: str, name: str, folder: Path) -> Path:
    beside = folder / name
    try:
        return beside if beside.is_file() else deployment_file(name)
    except CairnError as error:
        raise CairnError(f"{key} of the campaign: {error}") from error
