"""One sweep of a simulated scanner: each ray from where the robot is at its time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.rays import cast
from cairn.components.simulation.scanner_models import ScannerModel
from cairn.components.simulation.scene import SURFACES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Beams:
    """Which beams of a model are measured: every `skip`-th between two angles [rad]."""

    numbers: NDArray[np.int64]
    angles: Array
    times: Array

    @staticmethod
    def of(model: ScannerModel, first: float, last: float, skip: int) -> Beams:
        """Beams between `first` and `last` [rad]; times [s] are from the first of them."""
        angles: Array = model.first + model.increment * np.arange(model.steps, dtype=np.float64)
        inside = np.nonzero((angles >= first - 1e-9) & (angles <= last + 1e-9))[0][::skip]
        times = (inside - inside[0]) * model.time_increment if len(inside) else np.zeros(0)
        return Beams(inside, angles[inside], times)


@dataclass(frozen=True)
class Faults:
    """What goes wrong: dropouts of any beam [1]; of dark surfaces, and their share of the reach;
    share of beams that glass returns.
    """

    dropouts: float
    dark_dropouts: float
    dark_reach: float
    glass_returns: float


@dataclass(frozen=True)
class Surroundings:
    """What the rays may meet: segments (m, 4) [m] with surfaces (m,), people (k, 3) [m]."""

    segments: Array
    surfaces: NDArray[np.uint8]
    people: Array

    @property
    def without_glass(self) -> Surroundings:
        """What is left where glass does not count."""
        solid = self.surfaces != SURFACES["glass"]
        return Surroundings(self.segments[solid], self.surfaces[solid], self.people)


def sweep(
    model: ScannerModel,
    beams: Beams,
    faults: Faults,
    poses: Array,
    around: Surroundings,
    random: np.random.Generator,
) -> NDArray[np.float32]:
    """Ranges (n,) [m] of beams sent from `poses` (n, 3) [m, rad] of the scanner.

    Infinite where nothing was met, NaN where the beam failed.
    """
    count = beams.angles.size
    starts = np.ascontiguousarray(poses[:, :2])
    angles = poses[:, 2] + beams.angles
    ranges, hit = cast(starts, angles, around.segments, around.people, model.most)
    surfaces = _surfaces(hit, around.surfaces)
    _look_through_glass(ranges, surfaces, starts, angles, model.most, faults, around, random)
    dark = surfaces == SURFACES["dark"]
    ranges[dark & (ranges > faults.dark_reach * model.most)] = math.inf
    met = np.isfinite(ranges)
    deviation = np.maximum(model.noise_m, model.noise_share * np.where(met, ranges, 0.0))
    ranges += deviation * random.standard_normal(count)
    ranges[met & (ranges < model.least)] = math.nan
    ranges[ranges >= model.most] = math.inf
    chance = random.random(count)
    ranges[chance < np.where(dark, faults.dark_dropouts, faults.dropouts)] = math.nan
    return ranges.astype(np.float32)


def _surfaces(hit: NDArray[np.int64], standing: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The surface that each ray has met; people, and nothing, count as plain."""
    surfaces = np.full(hit.size, SURFACES["plain"], np.uint8)
    met = (hit >= 0) & (hit < standing.size)
    surfaces[met] = standing[hit[met]]
    return surfaces


def _look_through_glass(
    ranges: Array,
    surfaces: NDArray[np.uint8],
    starts: Array,
    angles: Array,
    reach: float,
    faults: Faults,
    around: Surroundings,
    random: np.random.Generator,
) -> None:
    """Let most rays that met glass go on to what is behind it."""
    through = np.nonzero(surfaces == SURFACES["glass"])[0]
    through = through[random.random(through.size) >= faults.glass_returns]
    if through.size:
        solid = around.without_glass
        ranges[through], behind = cast(
            starts[through], angles[through], solid.segments, solid.people, reach
        )
        surfaces[through] = _surfaces(behind, solid.surfaces)
