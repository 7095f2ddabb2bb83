"""The health of the pose: what decides how far it can be relied on, from 0 (lost) to 1."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.planar.scans import Rays
from cairn.schemas.cairn_nav_msgs import ReasonCode

# Between these two a measure goes from full trust to none.
_SPREAD_M, _HEADING, _FIT = (0.15, 0.60), (0.10, 0.50), (0.60, 0.25)
# From this share of beams explained a scan vouches for a pose.
FITS = 0.5
# The most that a pose is worth which was found but may yet turn out to be another.
_UNSURE = 0.45


@dataclass(frozen=True)
class PoseHealth:
    """`value` from 0 to 1; `reason` says in words what keeps it below 1, "" if nothing does.

    `code` is the reason's code; `fit` is the share of the scans' beams that the map explains, None
    without scans.
    """

    value: float
    code: ReasonCode
    reason: str
    support: PoseSupport
    fit: float | None


LOST = PoseHealth(
    0.0, ReasonCode.NOT_LOCATED, "the robot does not know where it is", PoseSupport(0, 0), None
)


def assess_health(pose: PoseEstimate, support: PoseSupport, fit: float | None) -> PoseHealth:
    """The health of a pose: that of its worst side (spread, heading, scan, objects)."""
    heading_sd = float(pose.covariance[2, 2]) ** 0.5
    sides = [
        (
            _between(pose.spread, *_SPREAD_M),
            ReasonCode.POSITION_UNCERTAIN,
            f"the position is uncertain by {pose.spread:.2f} m",
        ),
        (
            _between(heading_sd, *_HEADING),
            ReasonCode.HEADING_UNCERTAIN,
            f"the heading is uncertain by {heading_sd:.2f} rad",
        ),
    ]
    if fit is not None:
        sides.append(
            (
                _between(fit, *_FIT),
                ReasonCode.SCAN_MISMATCH,
                f"the map explains {fit:.0%} of the scan",
            )
        )
    if support.contradicting:
        seen = support.agreeing + support.contradicting
        least = 0.5 if fit is not None and fit >= FITS else 0.0
        sides.append(
            (
                max(least, support.agreeing / seen),
                ReasonCode.OBJECTS_CONTRADICT,
                f"of the places seen of late {support.agreeing} agree with the pose and "
                f"{support.contradicting} contradict it",
            )
        )
    value, code, reason = min(sides, key=lambda side: side[0])
    if value >= 1.0:
        code, reason = ReasonCode.NONE, ""
    return PoseHealth(value, code, reason, support, fit)


def limit_unconfirmed(health: PoseHealth, code: ReasonCode, reason: str) -> PoseHealth:
    """Return the health of a robot that may be elsewhere, for a `reason` in words."""
    value = min(health.value, _UNSURE)
    if health.reason:
        return replace(health, value=value)
    return replace(health, value=value, code=code, reason=reason)


def _between(measure: float, full: float, none: float) -> float:
    return min(1.0, max(0.0, (none - measure) / (none - full)))


SILENT_S = 1.0
"""For so long [s] scans may hit nothing, or not come at all."""
_UNTOLD_S = 0.6  # for so long [s] they may tell nothing
# The most that a pose is worth without scans that hit anything, and without such as tell anything.
_NO_HITS, _BLIND = 0.5, 0.2


class ScannerMonitor:
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

    def limited(self, health: PoseHealth, now: float, topic: str) -> PoseHealth:
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
