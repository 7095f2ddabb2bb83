"""The health of the pose: how far it can be relied on, from 0 (not located) to 1.

`hypotheses.py` decides where else the robot may be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.planar.scans import Rays
from cairn.schemas.cairn_nav_msgs import NO_REASON, Reason, ReasonCode

# Between these two values a measure goes from full health to none: the spread of the position [m],
# the deviation of the heading [rad], the share of the scan's beams that the map explains [1]. Half
# of the health is left at 0.38 m, nearly the robot's diameter (0.44 m), and at 0.3 rad: 0.9 m at 3
# m. Chosen by hand; `lab/constants.yaml` has the effect of half and double.
_SPREAD_M, _HEADING_RAD, _SCAN_FIT = (0.15, 0.60), (0.10, 0.50), (0.60, 0.25)
FITS = 0.5
"""From this share of explained beams on, a scan supports a pose."""
SURE_HEALTH = 0.5
"""From this health on the robot may complete its goal (AutoMove's `sure_health`).

It is the least health where objects contradict a pose but scans support it, as objects may have
been moved; and the most without scans that hit anything: a robot that sees nothing in reach may
drive.
"""
# The most health of a pose that may be wrong altogether: the robot may move (AutoMove's
# `least_health`), but a goal does not count as reached (`sure_health`).
_MOST_UNCONFIRMED = 0.45

SILENT_S = 1.0
"""Scans may be missing, invalid, or hit nothing, for so long [s]: ten scans at 10 Hz."""
# The most health without valid scans: a robot whose scanner fails stands (AutoMove's
# `least_health`).
_MOST_WITHOUT_SCANS = 0.2


@dataclass(frozen=True)
class PoseHealth:
    """`value` from 0 to 1, and the reason that keeps it below 1.

    `fit` is the share of the scans' beams that the map explains, None without scans.
    """

    value: float
    reason: Reason
    support: PoseSupport
    fit: float | None


LOST = PoseHealth(
    0.0,
    Reason(ReasonCode.NOT_LOCATED, "the robot does not know where it is"),
    PoseSupport(0, 0),
    None,
)


def assess_health(pose: PoseEstimate, support: PoseSupport, fit: float | None) -> PoseHealth:
    """Return the health of a pose: that of its worst aspect (spread, heading, scan, objects)."""
    heading_sd = float(pose.covariance[2, 2]) ** 0.5
    aspects = [
        (
            _share(pose.spread, *_SPREAD_M),
            ReasonCode.POSITION_UNCERTAIN,
            f"the position is uncertain by {pose.spread:.2f} m",
        ),
        (
            _share(heading_sd, *_HEADING_RAD),
            ReasonCode.HEADING_UNCERTAIN,
            f"the heading is uncertain by {heading_sd:.2f} rad",
        ),
    ]
    if fit is not None:
        aspects.append(
            (
                _share(fit, *_SCAN_FIT),
                ReasonCode.SCAN_MISMATCH,
                f"the map explains {fit:.0%} of the scan",
            )
        )
    if support.contradicting:
        least = SURE_HEALTH if fit is not None and fit >= FITS else 0.0
        share = support.agreeing / (support.agreeing + support.contradicting)
        aspects.append((max(least, share), ReasonCode.OBJECTS_CONTRADICT, contradiction(support)))
    value, code, text = min(aspects, key=lambda aspect: aspect[0])
    return PoseHealth(value, Reason(code, text) if value < 1.0 else NO_REASON, support, fit)


def contradiction(support: PoseSupport) -> str:
    """Return in words how many objects agree with the pose and contradict it."""
    return (
        f"of the recently observed objects {support.agreeing} agree with the pose and "
        f"{support.contradicting} contradict it"
    )


def limit_unconfirmed(health: PoseHealth, reason: Reason) -> PoseHealth:
    """Return the health of a robot that may be elsewhere, for that reason."""
    value = min(health.value, _MOST_UNCONFIRMED)
    worst = health.reason if health.reason.text else reason
    return replace(health, value=value, reason=worst)


class ScannerMonitor:
    """Limits the health of the pose while scans are missing, invalid, or hit nothing."""

    def __init__(self) -> None:
        self._valid_at = self._hit_at = -math.inf
        self._invalid = False

    def add(self, stamp: float, rays: Rays, contradicted: bool) -> bool:
        """Add a scan of that time [s]; return False if it is invalid.

        `contradicted`: it hit nothing, although the map has obstacles within its reach.
        """
        self._invalid = contradicted or not rays.informative
        if self._invalid:
            return False
        self._valid_at = stamp
        if np.isfinite(rays.ranges).any():
            self._hit_at = stamp
        return True

    def limit(self, health: PoseHealth, now: float, topic: str) -> PoseHealth:
        """Return the health at the time `now` [s] with the scans on `topic`."""
        if self._invalid and now - self._valid_at > SILENT_S:
            most, since = _MOST_WITHOUT_SCANS, now - self._valid_at
            text = f"no valid scan on {topic}"
            code = ReasonCode.SCAN_INVALID
        elif now - self._hit_at > SILENT_S:
            most, since = SURE_HEALTH, now - self._hit_at
            text = f"no scan on {topic} that hits anything"
            code = ReasonCode.SCAN_HITS_NOTHING
        else:
            return health
        how_long = f"for {since:.1f} s" if math.isfinite(since) else "so far"
        reason = Reason(code, f"{text} {how_long}")
        return replace(health, value=min(health.value, most), reason=reason)


def _share(measure: float, full: float, none: float) -> float:
    return min(1.0, max(0.0, (none - measure) / (none - full)))
