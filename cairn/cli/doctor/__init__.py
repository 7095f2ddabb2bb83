"""`cairn doctor`: checks of this computer and of deployments, each of which yields a `Finding`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes:
        topic: group of checks: `serial ports`.
        subject: what was checked: `/dev/ttyACM0`.
        state: `fail` if a robot cannot run, `warn` if it may not run well.
        found: the result, in words.
        remedy: what to do about it; empty if nothing is wrong.
    """

    topic: str
    subject: str
    state: State
    found: str
    remedy: str = ""
