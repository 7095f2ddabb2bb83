"""How far the pose can be relied on: from 0 (lost) to 1, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cairn.components.localizer.particles import Estimate
from cairn.components.localizer.recent import Support
from cairn.schemas.cairn_nav_msgs import ReasonCode

# Between these two a measure goes from full trust to none.
_SPREAD_M, _HEADING, _FIT = (0.15, 0.60), (0.10, 0.50), (0.60, 0.25)
# From this share of beams explained a scan vouches for a pose.
FITS = 0.5
# The most that a pose is worth which was found but may yet turn out to be another.
_UNSURE = 0.45


@dataclass(frozen=True)
class Health:
    """`value` from 0 to 1; `reason` says in words what keeps it below 1, "" if nothing does.

    `code` is the reason's code; `fit` is the share of the scans' beams that the map explains, None
    without scans.
    """

    value: float
    code: ReasonCode
    reason: str
    support: Support
    fit: float | None


LOST = Health(
    0.0, ReasonCode.NOT_LOCATED, "the robot does not know where it is", Support(0, 0), None
)


def health_of(pose: Estimate, support: Support, fit: float | None) -> Health:
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
    return Health(value, code, reason, support, fit)


def not_yet_sure(health: Health, code: ReasonCode, reason: str) -> Health:
    """Return the health of a robot that may be elsewhere, for a `reason` in words."""
    value = min(health.value, _UNSURE)
    if health.reason:
        return replace(health, value=value)
    return replace(health, value=value, code=code, reason=reason)


def _between(measure: float, full: float, none: float) -> float:
    return min(1.0, max(0.0, (none - measure) / (none - full)))
