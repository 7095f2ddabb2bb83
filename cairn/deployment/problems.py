"""Problems of a deployment: where, what was found, and what to do."""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from cairn.errors import CairnError


@dataclass(frozen=True)
class Location:
    """Where a key or value is written: a file with line and column from 1, or a `--set` (line 0).

    `folder` is the absolute folder that `${here}` refers to there.
    """

    origin: str
    line: int
    column: int
    folder: Path

    def __str__(self) -> str:
        return f"{self.origin}:{self.line}" if self.line else self.origin


@dataclass(frozen=True)
class Problem:
    """One problem of a deployment; `path` is dotted, with components by name, without parents."""

    at: Location
    path: str
    found: str
    remedy: str

    def __str__(self) -> str:
        path = f"{self.path}: " if self.path else ""
        return f"{self.at}: {path}{self.found}; {self.remedy}"


class DeploymentError(CairnError):
    """A deployment that cannot run, with all its problems."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        count = len(self.problems)
        lines = [f"the deployment has {count} problem{'s' if count > 1 else ''}:"]
        super().__init__("\n  ".join([*lines, *map(str, self.problems)]))

    def __reduce__(self) -> tuple[type["DeploymentError"], tuple[tuple[Problem, ...]]]:
        """Pickle the error by its problems instead of its text."""
        return DeploymentError, (self.problems,)


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return the remedy for an unknown name: similar names, or else all known names."""
    names = list(known)
    close = get_close_matches(name, names, cutoff=0.8) or get_close_matches(name, names, n=1)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"expected one of: {', '.join(names)}" if names else "there is none to choose from"
