"""One sweep of a simulated scanner: each ray from where the robot is at its time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.simulation.rays import cast
from components.simulation.scanner_models import ScannerModel
from components.simulation.scene import SURFACES
from planar.poses import Pose, wrap

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


def sweep(
    model: ScannerModel,
    beams: Beams,
    faults: Faults,
    begins: Pose,
    ends: Pose,
    around: Surroundings,
    random: np.random.Generator,
) -> NDArray[np.float32]:
    """Ranges (n,) [m] while the scanner moves evenly between two poses: inf nothing, NaN failed."""
    count = beams.angles.size
    share = beams.times / beams.times[-1] if count > 1 and beams.times[-1] > 0 else np.zeros(count)
    starts = np.empty((count, 2))
    starts[:, 0] = begins[0] + share * (ends[0] - begins[0])
    starts[:, 1] = begins[1] + share * (ends[1] - begins[1])
    angles = begins[2] + share * wrap(ends[2] - begins[2]) + beams.angles
    ranges, hit = cast(starts, angles, around.segments, around.people, model.most)
    surfaces = _surfaces(hit, around)
    _look_through_glass(ranges, hit, surfaces, starts, angles, model, faults, around, random)
    dark = surfaces == SURFACES["dark"]
    ranges[dark & (ranges > faults.dark_reach * model.most)] = math.inf
    met = np.isfinite(ranges)
    deviation = np.hypot(model.noise_m, model.noise_share * np.where(met, ranges, 0.0))
    ranges += deviation * random.standard_normal(count)
    ranges[met & (ranges < model.least)] = math.nan
    ranges[ranges >= model.most] = math.inf
    chance = random.random(count)
    ranges[chance < np.where(dark, faults.dark_dropouts, faults.dropouts)] = math.nan
    return ranges.astype(np.float32)


def _surfaces(hit: NDArray[np.int64], around: Surroundings) -> NDArray[np.uint8]:
    """The surface that each ray has met; people, and nothing, count as plain."""
    surfaces = np.zeros(hit.size, np.uint8)
    standing = (hit >= 0) & (hit < around.surfaces.size)
    surfaces[standing] = around.surfaces[hit[standing]]
    return surfaces


def _look_through_glass(
    ranges: Array,
    hit: NDArray[np.int64],
    surfaces: NDArray[np.uint8],
    starts: Array,
    angles: Array,
    model: ScannerModel,
    faults: Faults,
    around: Surroundings,
    random: np.random.Generator,
) -> None:
    """Let most rays that met glass go on to what is behind it."""
    through = np.nonzero(surfaces == SURFACES["glass"])[0]
    through = through[random.random(through.size) >= faults.glass_returns]
    if not through.size:
        return
    solid = np.nonzero(around.surfaces != SURFACES["glass"])[0]
    behind, what = cast(
        np.ascontiguousarray(starts[through]),
        np.ascontiguousarray(angles[through]),
        np.ascontiguousarray(around.segments[solid]),
        around.people,
        model.most,
    )
    ranges[through] = behind
    standing = (what >= 0) & (what < solid.size)
    surfaces[through] = SURFACES["plain"]
    surfaces[through[standing]] = around.surfaces[solid[what[standing]]]
    hit[through] = what
