"""How much of the scans the map explains, of late."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.health import FITS
from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.scanner_watch import SILENT_S
from cairn.planar.poses import Pose

Array = NDArray[np.float64]

# Share of the newest scan in the running mean.
_NEWEST = 0.2
# About so many rays that hit nothing are followed through the map.
_RAYS = 60


class ScanFit:
    """Running mean of the share (0 to 1) of a scan's beams that the map explains; None at first.

    A ray that hit nothing counts where the map has nothing either. Else it tells nothing, as glass
    and what is dark return no beam, unless no ray of the scan hits anything.
    """

    def __init__(self) -> None:
        self.value: float | None = None
        self._at = -math.inf
        self.contradicted = False
        """Whether the newest scan hit nothing where the map has obstacles."""

    def vouches(self, now: float) -> bool:
        """Whether scans fit well enough to speak for a pose at `now` [s], and still come."""
        return self.value is not None and self.value >= FITS and now - self._at <= SILENT_S

    def forget(self) -> None:
        """Begin anew: the robot is somewhere else."""
        self.value = None

    def note(
        self,
        stamp: float,
        field: LikelihoodField,
        pose: Pose,
        hits: Array,
        count: int,
        starts: Array,
        ends: Array,
    ) -> None:
        """Take a scan of `stamp` [s], seen from a pose: some `hits` (m, 2) [m] of `count`, and the
        `starts` and `ends` (k, 2) [m] of the rays that hit nothing.
        """
        self._at = stamp
        some = slice(None, None, 1 + len(starts) // _RAYS)
        clear = len(starts) * field.clear(pose, starts[some], ends[some]) if len(starts) else 0.0
        explained = count * field.fit(pose, hits) if count else 0.0
        self.contradicted = not count and clear < 0.5 * len(starts)
        if count + clear > 0:
            fit = (explained + clear) / (count + clear)
            before = fit if self.value is None else self.value
            self.value = before + _NEWEST * (fit - before)
