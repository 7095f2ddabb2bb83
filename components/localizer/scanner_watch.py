"""What the scanner has told of late: a pose that no scan speaks for is not to be relied on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cairn.components.localizer.health import Health
from cairn.planar.scans import Rays
from cairn.schemas.cairn_nav_msgs import ReasonCode

SILENT_S = 1.0
"""For so long [s] scans may hit nothing, or not come at all."""
_UNTOLD_S = 0.6  # for so long [s] they may tell nothing
# The most that a pose is worth without scans that hit anything, and without such as tell anything.
_NO_HITS, _BLIND = 0.5, 0.2


class ScannerWatch:
    """When scans last told anything, and when they last hit anything [s]."""

    def __init__(self) -> None:
        self._told = self._hit = -math.inf
        self._blind = False

    def note(self, stamp: float, rays: Rays, contradicted: bool) -> bool:
        """Take a scan of that time [s]; False if it tells nothing.

        `contradicted`: it hit nothing, although the map has obstacles within its reach.
        """
        self._blind = contradicted or not rays.informative
        if self._blind:
            return False
        self._told = stamp
        if np.isfinite(rays.ranges).any():
            self._hit = stamp
        return True

    def limited(self, health: Health, now: float, topic: str) -> Health:
        """What is left of a health at the time `now` [s] with the scans on `topic`."""
        if self._blind and now - self._told > _UNTOLD_S:
            most, since, what = _BLIND, now - self._told, "tells"
            code = ReasonCode.SCAN_INVALID
        elif now - self._hit > SILENT_S:
            most, since, what = _NO_HITS, now - self._hit, "hits"
            code = ReasonCode.SCAN_HITS_NOTHING
        else:
            return health
        how_long = f"for {since:.1f} s" if math.isfinite(since) else "so far"
        why = f"no scan on {topic} that {what} anything {how_long}"
        return replace(health, value=min(health.value, most), code=code, reason=why)
