"""Decides whether the working copy of a map is used again, or made again from the original."""

from __future__ import annotations

from logging import Logger
from pathlib import Path


def is_reusable(copy: Path, log: Logger, *, same: bool, ahead: bool) -> bool:
    """Return whether a copy is of the `same` map and not of a time `ahead` (another replay).

    Logs the decision and its reason to `log`.
    """
    if same and not ahead:
        log.info("reusing the working copy %s", copy)
        return True
    why = "it has data of a later time" if same else "it is a copy of another map"
    log.info("replacing the working copy %s: %s", copy, why)
    return False
