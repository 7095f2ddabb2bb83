"""How far an estimated track lies from the true one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import wrap_all


@dataclass(frozen=True)
class TrackError:
    """Errors of an estimated track at the times of the true one.

    `stamps` int64[N] ns; `position` float64[N] m; `heading` float64[N] rad, wrapped to +-pi.
    """

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    heading: NDArray[np.float64]

    @property
    def position_rmse(self) -> float | None:
        """Root mean square of the position error [m]; None without a common time."""
        return _rms(self.position)

    @property
    def heading_rmse(self) -> float | None:
        """Root mean square of the heading error [rad]; None without a common time."""
        return _rms(self.heading)


def track_error(
    estimate_stamps: NDArray[np.int64],
    estimate: NDArray[np.float64],
    truth_stamps: NDArray[np.int64],
    truth: NDArray[np.float64],
    longest_gap_ns: int,
) -> TrackError:
    """Compare an estimated track (N x 3: x, y m, heading rad) with the true one (M x 3).

    The estimate is interpolated at each true pose's time that lies within it; true poses in a
    gap of the estimate longer than `longest_gap_ns` are compared with the last estimate before,
    because that is what the robot believed. Stamps must not decrease.
    """
    if len(estimate) == 0 or len(truth) == 0:
        empty = np.empty(0)
        return TrackError(np.empty(0, np.int64), empty, empty)
    inside = (truth_stamps >= estimate_stamps[0]) & (truth_stamps <= estimate_stamps[-1])
    stamps = truth_stamps[inside]
    true = truth[inside]
    after = np.clip(np.searchsorted(estimate_stamps, stamps), 1, max(1, len(estimate) - 1))
    if len(estimate) == 1:
        after = np.zeros(len(stamps), np.intp)
    before = np.maximum(after - 1, 0)
    gap = estimate_stamps[after] - estimate_stamps[before]
    safe = np.where(gap > 0, gap, 1)
    share = np.where(
        (gap > 0) & (gap <= longest_gap_ns), (stamps - estimate_stamps[before]) / safe, 0.0
    )
    share = np.where((gap > longest_gap_ns) & (stamps >= estimate_stamps[after]), 1.0, share)
    step = estimate[after] - estimate[before]
    step[:, 2] = wrap_all(step[:, 2])
    believed = estimate[before] + share[:, None] * step
    difference = believed - true
    return TrackError(
        stamps, np.hypot(difference[:, 0], difference[:, 1]), wrap_all(difference[:, 2])
    )


def _rms(values: NDArray[np.float64]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None
