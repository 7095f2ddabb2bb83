"""What the doctor finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        topic: what it belongs to: `serial ports`.
        subject: the thing itself: `/dev/ttyACM0`.
        state: `fail` if a robot cannot run so, `warn` if it may not run well.
        found: what was found.
        remedy: what to do about it; empty where all is well.
    """

    topic: str
    subject: str
    state: State
    found: str
    remedy: str = ""
