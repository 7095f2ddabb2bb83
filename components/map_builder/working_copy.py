"""Which working copies of a map are gone on with."""

from __future__ import annotations

import logging
from pathlib import Path

LOG = logging.getLogger("cairn.map_builder")


def gone_on_with(copy: Path, *, same: bool, ahead: bool) -> bool:
    """Whether a copy is of the `same` map and not of a time `ahead`, as of another replay.

    The log is told, and if it is to be made anew, why.
    """
    if same and not ahead:
        LOG.info("going on with the working copy %s", copy)
        return True
    why = "what it holds is of a later time" if same else "it is a copy of another map"
    LOG.info("making the working copy %s anew: %s", copy, why)
    return False
