"""The report of a campaign: what was injected, what followed, what was violated; JSON and text."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cairn_lab.campaign.observations import GoalEnded
from cairn_lab.campaign.resources import ProcessUse

JSON_NAME, TEXT_NAME, OUTPUT_NAME = "report.json", "report.md", "output.log"
_MOST_FOLLOWED = 6
_LONGEST, _SAME = 160, 60  # characters of a line; of its begin, by which it repeats another one
_SHOWN_VIOLATIONS = 50


@dataclass
class FaultRecord:
    """A fault as it was injected; `skipped` says why it could not be, "" if it was.

    `followed` are the first warnings and errors in the log after it, until the next fault.
    """

    number: int
    kind: str
    at_s: float
    target: str = ""
    effect: str = ""
    until_s: float | None = None
    skipped: str = ""
    followed: list[str] = field(default_factory=list)

    def follow(self, text: str) -> None:
        """Add a line of the log, unless it repeats an earlier one with other figures."""
        known = {_without_figures(one) for one in self.followed}
        if len(self.followed) < _MOST_FOLLOWED and _without_figures(text) not in known:
            self.followed.append(text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ...")

    def __str__(self) -> str:
        """Return it in one line."""
        what = f"skipped: {self.skipped}" if self.skipped else f"{self.target}: {self.effect}"
        return f"{self.at_s:9.1f} s  fault {self.number}: {self.kind}: {what}"


@dataclass
class Violation:
    """A violated invariant: when and how, with the faults of the minute before.

    `recording` is a file in the report's folder, "" if there is none; `rerun` is the command that
    re-runs the components of which it holds everything, "" if it does so of none.
    """

    number: int
    invariant: str
    at_s: float
    text: str
    faults: list[int]
    recording: str = ""
    rerun: str = ""

    def __str__(self) -> str:
        """Return it in one line."""
        return f"{self.at_s:9.1f} s  VIOLATION {self.number}: {self.invariant}: {self.text}"


@dataclass
class CampaignReport:
    """The result of a campaign; times are in seconds since its start."""

    name: str
    deployment: str
    seed: int
    folder: Path
    started: str = ""
    duration_s: float = 0.0
    interrupted: bool = False
    launches: int = 0
    faults: list[FaultRecord] = field(default_factory=list)
    violations: list[Violation] = field(default_factory=list)
    goals: list[GoalEnded] = field(default_factory=list)
    processes: dict[str, ProcessUse] = field(default_factory=dict)

    @property
    def injected(self) -> list[FaultRecord]:
        """The faults that were not skipped."""
        return [fault for fault in self.faults if not fault.skipped]

    def goal_counts(self) -> dict[str, int]:
        """Return how many goals have ended in which state."""
        return dict(sorted(Counter(goal.state for goal in self.goals).items()))

    def fault_counts(self) -> dict[str, int]:
        """Return how many faults of which kind were injected."""
        return dict(sorted(Counter(fault.kind for fault in self.injected).items()))

    def as_plain(self) -> dict[str, Any]:
        """Return it as JSON values."""
        plain = asdict(self)
        plain["folder"] = str(self.folder)
        plain["duration_s"] = round(self.duration_s, 1)
        return {"cairn_campaign_report": 1, **plain}

    def write(self) -> None:
        """Write `report.json` and `report.md` into the folder."""
        text = json.dumps(self.as_plain(), indent=1)
        (self.folder / JSON_NAME).write_text(text + "\n", encoding="utf-8")
        (self.folder / TEXT_NAME).write_text(self.text(), encoding="utf-8")

    def summary(self) -> list[tuple[str, str]]:
        """Return the result as pairs of a name and a value."""
        skipped = len(self.faults) - len(self.injected)
        goals = ", ".join(f"{count} {state}" for state, count in self.goal_counts().items())
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.fault_counts().items())
        return [
            ("duration", f"{self.duration_s:.0f} s" + (", interrupted" * self.interrupted)),
            ("faults", f"{len(self.injected)} injected ({kinds or 'none'}), {skipped} skipped"),
            ("launches", str(self.launches)),
            ("goals", goals or "none"),
            ("violations", str(len(self.violations))),
        ]

    def text(self) -> str:
        """Return it as Markdown."""
        lines = [f"# Campaign {self.name}, seed {self.seed}", ""]
        lines += [f"- {name}: {value}" for name, value in self.summary()]
        lines += [f"- deployment: {self.deployment}", f"- started: {self.started}", ""]
        lines += ["## Violations", ""]
        lines += [] if self.violations else ["None.", ""]
        for violation in self.violations[:_SHOWN_VIOLATIONS]:
            lines += self._violation_lines(violation)
        if len(self.violations) > _SHOWN_VIOLATIONS:
            lines += [f"{len(self.violations) - _SHOWN_VIOLATIONS} more: see {JSON_NAME}.", ""]
        lines += [
            "## Processes",
            "",
            "| process | starts | anonymous memory: first sixth | last sixth | largest [MiB] "
            "| descriptors | threads |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {name} | {use.starts} | {use.first_mib:.1f} | {use.last_mib:.1f} | "
            f"{use.memory_mib:.1f} | {use.descriptors} | {use.threads} |"
            for name, use in self.processes.items()
        ]
        lines += [
            "",
            "Anonymous memory is what no file backs. It includes what components share with the "
            "process from which they were forked, so it is more than `cairn ps` shows. Descriptors "
            "and threads are the largest values.",
            "",
        ]
        lines += ["## Faults", "", "```text"]
        for fault in self.faults:
            lines.append(str(fault))
            lines += [f"             {line}" for line in fault.followed]
        return "\n".join([*lines, "```", ""])

    def _violation_lines(self, violation: Violation) -> list[str]:
        lines = [f"### {violation.number}. {violation.invariant} at {violation.at_s:.1f} s", ""]
        lines += [violation.text, ""]
        numbers = ", ".join(map(str, violation.faults)) or "none"
        lines.append(f"- faults in the minute before: {numbers}")
        if violation.recording:
            lines.append(f"- recording: {violation.recording}")
            nothing = "no component started within the recording; `last_s: 0` records all"
            lines.append(f"- re-run: {f'`{violation.rerun}`' if violation.rerun else nothing}")
        return [*lines, ""]


def _without_figures(text: str) -> str:
    """Return the begin of a log line without figures: equal for records of one statement."""
    return re.sub(r"\d+", "", text)[:_SAME]
