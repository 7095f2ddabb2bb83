"""What a campaign observes of its deployment; times in [s] since the campaign began."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

_LINE: Final = re.compile(
    r"(?:\d+:\d+:\d+\.\d+ )?(?P<level>[A-Z]+) +(?P<logger>[^ :]+): (?P<text>.*)"
)
_CHILD: Final = re.compile(
    r"child (?P<event>active|stopped|ended|failed|hung|start failed|stop failed|deviates|"
    r"held by request): (?P<name>[^ :]+)(?:: (?P<reason>.*))?"
)

ROOT: Final = "root"
ZYGOTE: Final = "zygote"

Role = Literal["root", "zygote", "component", "helper"]
"""What a process is; a process that a component has forked is a helper, whatever its name."""


@dataclass(frozen=True)
class LogLine:
    """A line that `cairn up` printed; level and logger are "" if it is not a log record."""

    at_s: float
    text: str
    level: str = ""
    logger: str = ""

    @classmethod
    def parsed(cls, at_s: float, line: str) -> LogLine:
        """Return the record of a line."""
        found = _LINE.fullmatch(line.rstrip("\n"))
        if found is None:
            return cls(at_s, line.rstrip("\n"))
        return cls(at_s, found["text"], found["level"], found["logger"])

    @property
    def child(self) -> tuple[str, str, str] | None:
        """Event, child and reason of a supervisor's line about a child; None for other lines."""
        found = _CHILD.fullmatch(self.text)
        return None if found is None else (found["event"], found["name"], found["reason"] or "")

    def __str__(self) -> str:
        """Return level, logger and text."""
        return f"{self.level} {self.logger}: {self.text}" if self.logger else self.text


@dataclass(frozen=True)
class ProcessSample:
    """A process of the run at one time.

    `name` is that of the component, `root`, `zygote`, or else its command line; on further machines
    it is `root_MACHINE` and `zygote_MACHINE`. `parent` is the name of the parent process, "" if
    that does not belong to the run. `created_s` is the time of its creation [s since 1970]: with
    the pid it identifies the process. `memory_mib` is its anonymous memory.
    """

    pid: int
    name: str
    parent: str
    role: Role
    created_s: float
    memory_mib: float
    descriptors: int
    threads: int


Processes = Mapping[int, ProcessSample]
"""The processes of the run by their ids."""


@dataclass(frozen=True)
class GoalEnded:
    """The end of a goal: its state (`succeeded`, `failed`, `canceled`, `lost`, `late`) and reason.

    `lost`: the client has got no result, for a `reason`; `late`: it had not ended within its limit,
    and `reason` is what the robot was doing.
    """

    at_s: float
    pose: tuple[float, float, float]
    state: str
    reason: str
    took_s: float


@dataclass(frozen=True)
class DeploymentEnded:
    """The end of `cairn up`: expected if the campaign has stopped or killed it.

    `code` and `last_lines` are those of the machine on which it has ended first, `reports` the
    report folders of all machines, the main one first. `left` are processes of the run that were
    still there 10 s later; they were killed.
    """

    at_s: float
    expected: bool
    code: int
    reports: tuple[Path, ...]
    left: tuple[str, ...]
    last_lines: tuple[str, ...]
