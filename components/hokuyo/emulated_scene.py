"""What an emulated scanner sees: a room in which something walks about."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo.emulated_models import ScipModel

ECHOES = 3
"""At most so many echoes come back along one beam."""

NO_ECHO = -1
"""In place of an echo that a step does not have."""

Values = NDArray[np.int32]


@dataclass(frozen=True)
class Turn:
    """What one turn of the mirror measures: values as they are sent, of all steps from 0 on.

    `distances` [mm, or a code of what failed] and `intensities` [no unit]: shape (steps, `ECHOES`),
    `NO_ECHO` where there is none; the first echo of a step is always there.
    """

    distances: Values
    intensities: Values


class Scene(Protocol):
    """Where the scanner stands."""

    def turn(self, number: int, began_s: float) -> Turn:
        """What turn `number`, which began at that time [s], measures."""
        ...


class Room:
    """A room of 6 by 4 m with two pillars, a curtain that lets half the light through, a walker.

    No two scans are alike: the walker moves, and every value has its noise, which depends on the
    seed and the turn's number alone.
    """

    _NOISE_MM = 6.0
    _CURTAIN_MM = 1500.0  # its distance, from 60 to 80 degrees to the left
    _WALKER_MM = 200.0  # its radius; it walks on a circle about the scanner

    def __init__(self, model: ScipModel, seed: int = 0) -> None:
        self._model = model
        self._seed = seed
        steps = np.arange(model.steps)
        self._angles = 2.0 * math.pi * (steps - model.front) / model.turn_steps
        self._walls = np.minimum(
            _box(self._angles, ahead=4000.0, behind=2000.0, left=2200.0, right=1800.0),
            np.minimum(
                _disc(self._angles, 2500.0, -0.5, 250.0), _disc(self._angles, 1900.0, 1.7, 150.0)
            ),
        )
        degrees = np.degrees(self._angles)
        self._curtain = (degrees > 60.0) & (degrees < 80.0)
        self._opening = (degrees > -20.0) & (degrees < -15.0)  # a door: nothing comes back
        self._close = (degrees > -95.0) & (degrees < -93.0)  # a bar right before it

    def turn(self, number: int, began_s: float) -> Turn:
        """What is seen then."""
        model = self._model
        random = np.random.default_rng((self._seed, number))
        walker = _disc(self._angles, 1200.0, 0.8 * began_s, self._WALKER_MM)
        hard = np.minimum(self._walls, walker)
        behind = self._curtain & (hard > self._CURTAIN_MM)
        found = np.full((model.steps, ECHOES), np.inf)
        found[:, 0] = np.where(behind, self._CURTAIN_MM, hard)
        found[behind, 1] = hard[behind]
        third = behind & (np.arange(model.steps) % 3 == 0)
        found[third, 2] = hard[third] + 400.0
        found += random.normal(0.0, self._NOISE_MM, found.shape)
        strength = 3.0e6 / np.maximum(found, 300.0) * (0.9 + 0.2 * random.random(found.shape))
        distances = np.where(np.isfinite(found), found, 0.0).astype(np.int32)
        intensities = strength.astype(np.int32)
        absent = ~np.isfinite(found) | (found > model.sight_mm)
        absent[self._opening] = True
        distances[absent], intensities[absent] = NO_ECHO, NO_ECHO
        near = self._close | ((distances[:, 0] != NO_ECHO) & (distances[:, 0] < model.least_mm))
        for code, where in ((model.nothing, absent[:, 0]), (model.near, near)):
            distances[where] = NO_ECHO
            intensities[where] = NO_ECHO
            distances[where, 0] = code
            intensities[where, 0] = 0
        return Turn(distances, intensities)


@dataclass(frozen=True)
class Still:
    """The same values at every turn, as a test wants them sent."""

    measured: Turn

    def turn(self, number: int, began_s: float) -> Turn:  # noqa: ARG002 - a scene may need them
        """These values."""
        return self.measured

    @classmethod
    def of(cls, distances: Values, intensities: Values | None = None) -> Still:
        """One echo at each step, from step 0 on."""

        def alone(values: Values) -> Values:
            table = np.full((values.size, ECHOES), NO_ECHO, np.int32)
            table[:, 0] = values
            return table

        strengths = np.zeros_like(distances) if intensities is None else intensities
        return cls(Turn(alone(distances), alone(strengths)))


def _box(
    angles: NDArray[np.float64], *, ahead: float, behind: float, left: float, right: float
) -> NDArray[np.float64]:
    """Distance of a rectangle's sides from a point within."""
    across, along = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        return np.minimum(
            np.where(across > 0, ahead, behind) / np.abs(across),
            np.where(along > 0, left, right) / np.abs(along),
        )


def _disc(
    angles: NDArray[np.float64], distance: float, bearing: float, radius: float
) -> NDArray[np.float64]:
    """Distance of a disc's near side; infinite where the beam passes it."""
    beside = angles - bearing
    within = (np.abs(distance * np.sin(beside)) < radius) & (np.cos(beside) > 0)
    depth = np.sqrt(np.where(within, radius**2 - (distance * np.sin(beside)) ** 2, 0.0))
    return np.where(within, distance * np.cos(beside) - depth, np.inf)
